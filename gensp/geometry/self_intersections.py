"""Faces of a surface that pass through each other."""

import igl.predicates
import numpy as np
from jaxtyping import Bool

from gensp.geometry.mesh import Mesh


def self_intersecting_faces(mesh: Mesh) -> Bool[np.ndarray, " m"]:
    """Faces that meet another one elsewhere than at a vertex or an edge of both.

    By exact predicates over a hierarchy of boxes (libigl). Faces that merely touch without sharing
    the vertices, as in a soup, count; faces with a corner that is no number do not.
    """
    marks = np.zeros(len(mesh.faces), dtype=bool)
    whole = np.flatnonzero(np.isfinite(mesh.vertices).all(axis=1)[mesh.faces].all(axis=1))
    vertices = np.where(np.isfinite(mesh.vertices), mesh.vertices, 0.0)
    faces = np.ascontiguousarray(mesh.faces[whole])
    if len(faces) > 1:
        found, pairs, _ = igl.predicates.find_self_intersections(vertices, faces, False)
        if found:
            marks[whole[np.unique(np.asarray(pairs))]] = True
    return marks
