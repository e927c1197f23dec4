"""The unit sphere S_0: icospheres, sampling, tangent frames."""

from functools import lru_cache

import numpy as np
import trimesh
from jaxtyping import Float

from gensp.errors import MissingData
from gensp.geometry.mesh import Mesh


def unit(x: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Radial projection to the unit sphere; zero vectors stay zero."""
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    return x / np.where(length > 0, length, 1)


@lru_cache(maxsize=8)
def icosphere(level: int) -> Mesh:
    """Subdivided icosahedron with 10·4^level + 2 unit vertices.

    The vertices of every coarser level come first, so levels are nested.
    """
    if level == 0:
        solid = trimesh.creation.icosahedron()
        mesh = Mesh(unit(np.array(solid.vertices)), np.array(solid.faces, dtype=np.int64))
    else:
        coarse = icosphere(level - 1)
        vertices, faces = _midpoint_subdivision(coarse)
        mesh = Mesh(vertices, faces)
    mesh.vertices.setflags(write=False)
    mesh.faces.setflags(write=False)
    return Mesh(mesh.vertices, mesh.faces, "sphere")


def icosphere_of(vertices: int) -> Mesh:
    """The icosphere that has so many vertices.

    Raises
    ------
    MissingData
        None has.
    """
    for level in range(11):
        if 10 * 4**level + 2 == vertices:
            return icosphere(level)
    raise MissingData(
        f"{vertices} vertices belong to no icosphere; 12, 42, 162, 642, 2562, … are required; "
        "make the values again with the stage that wrote them"
    )


def _midpoint_subdivision(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    sides = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]]
    edges, inverse = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middle = len(mesh.vertices) + inverse.reshape(-1, 3)
    # Only the new vertices are projected: the coarser levels stay, bit for bit.
    vertices = np.concatenate([mesh.vertices, unit(mesh.vertices[edges].mean(axis=1))])
    a, b, c = mesh.faces.T
    ab, bc, ca = middle.T
    faces = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)
    return vertices, faces.astype(np.int64)


def sample_sphere(count: int, generator: np.random.Generator) -> Float[np.ndarray, "count 3"]:
    """Uniform random points of the unit sphere."""
    return unit(generator.standard_normal((count, 3)))


def tangent_frame(p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 2"]:
    """Two orthonormal tangents at every sphere point, by Gram–Schmidt against the radius.

    The frame is right-handed: its cross product is the outward radius. Source: paper §4.4.
    """
    axis = np.where(np.abs(p[:, :1]) < 0.8, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]))
    first = unit(axis - np.sum(axis * p, axis=1, keepdims=True) * p)
    return np.stack([first, np.cross(p, first)], axis=2)
