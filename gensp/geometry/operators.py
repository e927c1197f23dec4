"""Differential operators of triangle meshes: stiffness, mass, adjacency."""

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from gensp.geometry.mesh import Mesh

# Relative to the median edge weight: keeps clamped Laplacians connected and definite.
_SMALLEST_WEIGHT = 1e-3
# Of the mean edge length.
_LENGTH_MARGIN = 1e-5


def cotangent_laplacian(mesh: Mesh) -> sp.csc_matrix:
    """Positive semidefinite cotangent stiffness matrix (n, n); constants are its kernel."""
    return sp.csc_matrix(-igl.cotmatrix(mesh.vertices, mesh.faces))


def delaunay_laplacian(mesh: Mesh) -> sp.csc_matrix:
    """Cotangent stiffness of the intrinsic Delaunay triangulation: no weight is negative.

    Edge lengths are first made to satisfy the triangle inequality with a margin, as flips need
    not end on triangles without area.

    Sources: Bobenko and Springborn 2007; margin: Sharp and Crane 2020, "A Laplacian for
    nonmanifold triangle meshes".
    """
    lengths = igl.edge_lengths(mesh.vertices, mesh.faces)
    margin = _LENGTH_MARGIN * lengths.mean()
    slack = lengths.sum(axis=1) - 2 * lengths.max(axis=1)
    lengths = lengths + max(0.0, margin - float(slack.min()))
    flipped, faces, *_ = igl.intrinsic_delaunay_triangulation(lengths, mesh.faces)
    return sp.csc_matrix(-igl.cotmatrix_intrinsic(flipped, faces))


def clamped_laplacian(mesh: Mesh) -> sp.csc_matrix:
    """Cotangent stiffness with every edge weight at least 1e-3 of the median weight.

    A Laplacian of positive weights is definite on each component whatever the triangles' angles,
    which the plain one is not for elastic energies on obtuse triangles. A triangle without area
    has no cotangents: its edges get the least weight.
    """
    weights = sp.coo_matrix(-cotangent_laplacian(mesh))
    off = weights.row != weights.col
    i, j, w = weights.row[off], weights.col[off], weights.data[off]
    finite = np.isfinite(w)
    least = _SMALLEST_WEIGHT * np.median(np.abs(w[finite]))
    return weighted_laplacian(i, j, np.maximum(np.where(finite, w, 0), least))


def weighted_laplacian(
    i: Int[np.ndarray, " e"], j: Int[np.ndarray, " e"], weights: Float[np.ndarray, " e"]
) -> sp.csc_matrix:
    """Graph Laplacian Σ w_ij (x_i − x_j)² of directed edges listed in both directions."""
    size = int(max(i.max(), j.max())) + 1
    off = sp.csc_matrix((weights, (i, j)), shape=(size, size))
    return sp.csc_matrix(sp.diags(np.asarray(off.sum(axis=1)).reshape(-1)) - off)


def adjacency(faces: Int[np.ndarray, "m 3"]) -> sp.csr_matrix:
    """Symmetric 0/1 matrix (n, n) of the 1-rings N_i."""
    i, j = faces[:, [0, 1, 2]].reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    graph = sp.csr_matrix((np.ones(2 * len(i)), (np.append(i, j), np.append(j, i))))
    graph.data[:] = 1
    return graph


class FullMass:
    """Mass matrices (n, n) of linear elements on one triangulation; the pattern is found once.

    A triangle gives a sixth of its area to its corners, a twelfth to its edges.
    """

    def __init__(self, faces: Int[np.ndarray, "m 3"], count: int) -> None:
        corners = np.repeat(faces, 3, axis=1), np.tile(faces, (1, 3))
        keys, place = np.unique(corners[1] * count + corners[0], return_inverse=True)
        self._place, self._size = place.reshape(-1), len(keys)
        counts = np.bincount(keys // count, minlength=count)
        self._indices = (keys % count).astype(np.int32)
        self._indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._shares = np.where(corners[0] == corners[1], 1 / 6, 1 / 12)

    def __call__(
        self, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
    ) -> sp.csc_matrix:
        """The matrix at positions of the vertices."""
        areas = igl.doublearea(vertices, faces).reshape(-1, 1) / 2
        data = np.bincount(self._place, (areas * self._shares).reshape(-1), self._size)
        return sp.csc_matrix((data, self._indices, self._indptr), shape=(len(vertices),) * 2)


def lumped_mass(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """Barycentric vertex areas: a third of every incident triangle."""
    areas = igl.doublearea(vertices, faces).reshape(-1) / 6
    return np.bincount(faces.reshape(-1), np.repeat(areas, 3), minlength=len(vertices))
