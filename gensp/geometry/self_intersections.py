"""Faces of a surface that pass through each other."""

import igl.predicates
import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.geometry.mesh import Mesh


def self_intersecting_faces(mesh: Mesh) -> Bool[np.ndarray, " m"]:
    """Faces that meet another one elsewhere than at a vertex or an edge of both.

    By exact predicates over a hierarchy of boxes (libigl). Faces that merely touch without sharing
    the vertices, as in a soup, count, and so do copies of one face; faces with a corner that is no
    number do not.
    """
    finite = np.isfinite(mesh.vertices).all(axis=1)[mesh.faces].all(axis=1)
    marks = np.zeros(len(mesh.faces), dtype=bool)
    whole = np.flatnonzero(finite)
    if len(whole) > 1:
        vertices = np.where(np.isfinite(mesh.vertices), mesh.vertices, 0.0)
        marks[whole] = _crossing(vertices, np.ascontiguousarray(mesh.faces[whole]))
    return marks


def _crossing(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    # Of n copies of a face all n² pairs would be listed: one stands for them.
    places = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)
    _, first, kind, copies = np.unique(
        np.sort(places[faces], axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    crossing = copies > 1
    found, pairs, _ = igl.predicates.find_self_intersections(vertices, faces[first], False)
    if found:
        crossing[np.unique(np.asarray(pairs))] = True
    return crossing[kind.reshape(-1)]
