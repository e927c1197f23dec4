"""Cholesky factorisation of large mesh matrices, by dense blocks (Duff & Reid 1983).

The unknowns of a part of a nested dissection are eliminated together: what touches them is
gathered in a dense matrix, the front, of which LAPACK factors the part's own rows; the rest is
handed on to the front above.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

from gensp.compiled.fronts import extend_add
from gensp.geometry.dissection import Part, nested_dissection


@dataclass(frozen=True)
class _Front:
    """Where a part's dense matrix comes from; unknowns are counted in the order of elimination.

    Attributes
    ----------
    own
        Unknowns that are eliminated here.
    later
        Unknowns, ascending, that they touch and that are eliminated later.
    diagonal, coupling
        Places in the matrix's values, and in the block own × own or later × own, column by column.
    children
        Front, and for every `later` of it its row here.
    """

    own: slice
    later: np.ndarray
    diagonal: tuple[np.ndarray, np.ndarray]
    coupling: tuple[np.ndarray, np.ndarray]
    children: tuple[tuple[int, np.ndarray], ...]


class MultifrontalCholesky:
    """L Lᵀ of a sparse symmetric positive definite matrix on a surface mesh.

    Parameters
    ----------
    matrix
        (n, n), without repeated entries, rows sorted in each column.
    points
        Positions (n / b, 3) of the vertices, b consecutive unknowns each.

    Raises
    ------
    ValueError
        The unknowns do not sit at the points evenly.
    numpy.linalg.LinAlgError
        The matrix is not positive definite to working precision.
    """

    def __init__(self, matrix: sp.csc_matrix, points: Float[np.ndarray, "k 3"]) -> None:
        block, rest = divmod(matrix.shape[0], len(points))
        if rest:
            raise ValueError(
                f"{matrix.shape[0]} unknowns do not sit at {len(points)} points evenly"
            )
        graph = _graph(matrix, block)
        parts = nested_dissection(graph, points)
        order = np.concatenate([part.vertices for part in parts])
        self._order = _blocks(order, block)
        self._fronts = _fronts(_lower(matrix, self._order), parts, graph[order][:, order], block)
        self.refactor(matrix.data)

    def refactor(self, values: Float[np.ndarray, " nnz"]) -> None:
        """Factor other values in the same places of the matrix."""
        updates: dict[int, np.ndarray] = {}
        self._factors = [
            _eliminated(place, front, values, updates) for place, front in enumerate(self._fronts)
        ]

    def solve(self, rhs: Float[np.ndarray, "n *c"]) -> Float[np.ndarray, "n *c"]:
        """Solution for one right-hand side or several."""
        x = np.array(rhs[self._order].reshape(len(rhs), -1), order="F")
        for front, (diagonal, coupling) in zip(self._fronts, self._factors, strict=True):
            x[front.own] = dtrsm(1.0, diagonal, x[front.own], lower=1)
            x[front.later] -= coupling @ x[front.own]
        for front, (diagonal, coupling) in zip(
            reversed(self._fronts), reversed(self._factors), strict=True
        ):
            known = x[front.own] - coupling.T @ x[front.later]
            x[front.own] = dtrsm(1.0, diagonal, known, lower=1, trans_a=1)
        solution = np.empty_like(x)
        solution[self._order] = x
        return solution.reshape(rhs.shape)


def _eliminated(
    place: int, front: _Front, values: np.ndarray, updates: dict[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Factor a front's own rows; what is left for the fronts above is put among the updates."""
    own, later = front.own.stop - front.own.start, len(front.later)
    diagonal = _filled((own, own), front.diagonal, values)
    coupling = _filled((later, own), front.coupling, values)
    rest = np.zeros((later, later), order="F")
    for child, rows in front.children:
        extend_add(updates.pop(child), rows, diagonal, coupling, rest)
    diagonal, failed = dpotrf(diagonal, lower=1, overwrite_a=1, clean=0)
    if failed:
        raise np.linalg.LinAlgError("the sparse matrix is singular or not positive definite")
    if later:
        coupling = dtrsm(1.0, diagonal, coupling, side=1, lower=1, trans_a=1, overwrite_b=1)
        updates[place] = dsyrk(-1.0, coupling, beta=1.0, c=rest, lower=1, overwrite_c=1)
    return diagonal, coupling


def _filled(
    shape: tuple[int, int], places: tuple[np.ndarray, np.ndarray], values: np.ndarray
) -> np.ndarray:
    """A block in LAPACK's column order, zero but for the matrix's own values."""
    source, target = places
    block = np.zeros(shape[0] * shape[1])
    block[target] = values[source]
    return block.reshape(shape, order="F")


def _graph(matrix: sp.csc_matrix, block: int) -> sp.csr_matrix:
    """Which vertices share an entry of the matrix."""
    if block == 1:
        return matrix.tocsr()
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr)) // block
    count = matrix.shape[0] // block
    entries = (np.ones(matrix.nnz, bool), (matrix.indices // block, column))
    return sp.csr_matrix(entries, shape=(count, count))


def _blocks(vertices: np.ndarray, block: int) -> np.ndarray:
    """The unknowns of vertices."""
    return (vertices[:, None] * block + np.arange(block)).reshape(-1)


def _lower(matrix: sp.csc_matrix, order: np.ndarray) -> sp.csc_matrix:
    """Places, counted from 1, of the values in the lower triangle of the permuted matrix."""
    counted = np.arange(1, matrix.nnz + 1, dtype=np.float64)
    places = sp.csc_matrix((counted, matrix.indices, matrix.indptr), matrix.shape)
    permuted = sp.tril(places[order][:, order], format="csc")
    permuted.sort_indices()
    return permuted


def _fronts(
    lower: sp.csc_matrix, parts: Sequence[Part], graph: sp.csr_matrix, block: int
) -> list[_Front]:
    """The symbolic factorisation: `graph` and `lower` are in the order of elimination."""
    fronts: list[_Front] = []
    later: list[np.ndarray] = []  # of each part, as vertices
    end = 0
    for part in parts:
        start, end = end, end + len(part.vertices)
        touched = graph.indices[graph.indptr[start] : graph.indptr[end]]
        every = np.concatenate([touched, *(later[child] for child in part.children)])
        later.append(np.unique(every[every >= end]))
        rows = np.concatenate([np.arange(start, end), later[-1]])
        own = slice(start * block, end * block)
        children = tuple(
            (child, _blocks(np.searchsorted(rows, later[child]), block)) for child in part.children
        )
        unknowns = _blocks(rows, block)
        fronts.append(
            _Front(own, _blocks(later[-1], block), *_places(lower, own, unknowns), children)
        )
    return fronts


def _places(
    lower: sp.csc_matrix, own: slice, rows: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Where the values of the own columns stand, and where they go in the two blocks."""
    count = own.stop - own.start
    entries = slice(lower.indptr[own.start], lower.indptr[own.stop])
    source = lower.data[entries].astype(np.int64) - 1
    column = np.repeat(np.arange(count), np.diff(lower.indptr[own.start : own.stop + 1]))
    row = np.searchsorted(rows, lower.indices[entries])
    top = row < count
    below = row[~top] - count + column[~top] * (len(rows) - count)
    return (source[top], row[top] + column[top] * count), (source[~top], below)
