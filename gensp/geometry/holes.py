"""Closing holes: boundary loops filled with triangles."""

import numpy as np
from jaxtyping import Int

from gensp.geometry.diagnosis import boundary_half_edges, boundary_labels
from gensp.geometry.mesh import Mesh


def fill_holes(mesh: Mesh, longest: float) -> tuple[Mesh, int]:
    """Fill every hole whose rim is at most `longest` long; gives the mesh and their number.

    A hole of three sides becomes a triangle, a larger one a fan around its rim's centre. The
    mesh must be oriented and free of non-manifold vertices, so that every rim is one loop.
    """
    sides = boundary_half_edges(mesh.faces)
    count, label = boundary_labels(sides)
    if count == 0:
        return mesh, 0
    start, end = mesh.vertices[sides[:, 0]], mesh.vertices[sides[:, 1]]
    lengths = np.linalg.norm(end - start, axis=1)
    rims = np.bincount(label, weights=lengths)
    number = np.bincount(label)
    small = (rims <= longest) & (number >= 3)
    triangles = _triangles(sides, label, small & (number == 3))
    fanned = small & (number > 3)
    middle = (start + end) / 2 * lengths[:, None]
    centres = np.stack([np.bincount(label, weights=x) for x in middle.T], axis=1)
    place = np.cumsum(fanned) - 1 + len(mesh.vertices)
    part = fanned[label]
    fans = np.stack([sides[part, 1], sides[part, 0], place[label[part]]], axis=1)
    vertices = np.concatenate([mesh.vertices, centres[fanned] / rims[fanned, None]])
    faces = np.concatenate([mesh.faces, triangles, fans]).astype(np.int64)
    return Mesh(vertices, faces, mesh.name), int(small.sum())


def _triangles(
    sides: Int[np.ndarray, "b 2"], label: Int[np.ndarray, " b"], three: np.ndarray
) -> Int[np.ndarray, "k 3"]:
    """One triangle for every loop of three sides, against the direction of its rim."""
    _, first = np.unique(label, return_index=True)
    total = np.bincount(label, weights=sides[:, 0]).astype(np.int64)
    a, b = sides[first[three]].T
    return np.stack([b, a, total[three] - a - b], axis=1)
