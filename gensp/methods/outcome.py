"""What a method hands out: the map of a mesh, its bad faces counted or none by certificate."""

from typing import Any

import numpy as np
from jaxtyping import Float

from gensp.geometry.certificate import require_bijective
from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.spherical_map import SphericalMap


def finished(
    mesh: Mesh, sphere: Float[np.ndarray, "n 3"], diagnostics: dict[str, Any]
) -> SphericalMap:
    """The map of a mesh in its own coordinates, bad faces and degree in its diagnostics."""
    found = {
        "bad_faces": int(bad_faces(sphere, mesh.faces).sum()),
        "degree": map_degree(sphere, mesh.faces),
    }
    return SphericalMap(sphere, mesh.vertices, mesh.faces, mesh.name, {**diagnostics, **found})


def certified(
    mesh: Mesh, sphere: Float[np.ndarray, "n 3"], diagnostics: dict[str, Any]
) -> SphericalMap:
    """As `finished`, of a method that promises a bijective map: nothing may move it any more.

    Raises
    ------
    NotEmbeddable
        The last operations left a fold, which is told with its place.
    """
    require_bijective(mesh, sphere, remedy="remesh the surface there")
    found = {"bad_faces": 0, "degree": 1}
    return SphericalMap(sphere, mesh.vertices, mesh.faces, mesh.name, {**diagnostics, **found})
