"""Sparse symmetric positive definite systems, factored once or once per change of values.

Up to about ten thousand unknowns a simplicial L D Lᵀ whose symbolic analysis is kept (qdldl) is
fastest; above, dense blocks pay and a supernodal LU on a nested-dissection order wins.
"""

from typing import Protocol

import numpy as np
import qdldl
import scipy.sparse as sp
import scipy.sparse.linalg
from jaxtyping import Float, Int

SUPERNODAL_FROM = 15_000
_LEAF = 24


class _Factor(Protocol):
    def refactor(self, values: np.ndarray) -> None: ...

    def solve(self, rhs: np.ndarray) -> np.ndarray: ...


class SPDSolver:
    """Solver of A x = b for a sequence of matrices A with one sparsity pattern.

    Parameters
    ----------
    matrix
        Sparse symmetric positive definite (n, n).
    points
        Positions (n / b, 3) of the vertices that the unknowns sit at, b consecutive unknowns each.
        With them a large system is ordered by nested dissection (George 1973); without, by COLAMD,
        which costs about three times as much at 80,000 unknowns.

    Raises
    ------
    numpy.linalg.LinAlgError
        Values that are not finite, or a matrix that is singular to working precision.
    """

    def __init__(
        self, matrix: sp.spmatrix, points: Float[np.ndarray, "k 3"] | None = None
    ) -> None:
        matrix = _canonical(matrix)
        self.shape = matrix.shape
        self._indptr, self._indices = matrix.indptr, matrix.indices
        _require_finite(matrix.data)
        self._factor: _Factor = (
            _SimplicialFactor(matrix)
            if matrix.shape[0] < SUPERNODAL_FROM
            else _SupernodalFactor(matrix, points)
        )

    def refactor(self, matrix: sp.spmatrix) -> None:
        """Factor other values on the same pattern; the symbolic analysis is kept.

        Raises
        ------
        ValueError
            The pattern differs from the one analysed.
        """
        matrix = _canonical(matrix)
        same = np.array_equal(matrix.indptr, self._indptr)
        if not same or not np.array_equal(matrix.indices, self._indices):
            raise ValueError("refactor needs the sparsity pattern of the first matrix")
        _require_finite(matrix.data)
        self._factor.refactor(matrix.data)

    def solve(self, rhs: Float[np.ndarray, "n *c"]) -> Float[np.ndarray, "n *c"]:
        """Solution x for one right-hand side (n,) or several (n, c)."""
        solution = self._factor.solve(np.asarray(rhs, dtype=np.float64))
        if not np.isfinite(solution).all():
            raise np.linalg.LinAlgError("the sparse matrix is singular or not positive definite")
        return solution


def factored(
    solver: SPDSolver | None, matrix: sp.spmatrix, points: Float[np.ndarray, "k 3"]
) -> SPDSolver:
    """The solver with another matrix of its pattern factored, or a new one where there is none."""
    if solver is None:
        return SPDSolver(matrix, points)
    solver.refactor(matrix)
    return solver


def _canonical(matrix: sp.spmatrix) -> sp.csc_matrix:
    matrix = sp.csc_matrix(matrix)
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    return matrix


def _require_finite(values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise np.linalg.LinAlgError("the sparse matrix holds values that are not finite")


class _SimplicialFactor:
    """L D Lᵀ on an AMD order (qdldl), fed with the upper triangle."""

    def __init__(self, matrix: sp.csc_matrix) -> None:
        columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
        self._upper = matrix.indices <= columns
        self._pattern = sp.triu(matrix, format="csc")
        self._solver = self._guarded(qdldl.Solver, self._pattern)

    def refactor(self, values: np.ndarray) -> None:
        self._pattern.data = values[self._upper]
        self._guarded(self._solver.update, self._pattern)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        if rhs.ndim == 1:
            return np.asarray(self._solver.solve(np.ascontiguousarray(rhs)))
        return np.stack([self._solver.solve(np.ascontiguousarray(b)) for b in rhs.T], axis=1)

    @staticmethod
    def _guarded(factor, upper: sp.csc_matrix):  # type: ignore[no-untyped-def]
        try:
            return factor(upper, upper=True)
        except RuntimeError as error:
            raise np.linalg.LinAlgError(
                f"the sparse matrix cannot be factored: {error}"
            ) from error


class _SupernodalFactor:
    """LU without pivoting on a symmetric order (SuperLU)."""

    def __init__(self, matrix: sp.csc_matrix, points: np.ndarray | None) -> None:
        size = matrix.shape[0]
        self._order = np.arange(size) if points is None else _block_dissection(matrix, points)
        self._column_order = "COLAMD" if points is None else "NATURAL"
        # The permuted positions of the stored values, so that refactoring moves values only.
        tagged = sp.csc_matrix(
            (np.arange(matrix.nnz, dtype=np.float64), matrix.indices, matrix.indptr), matrix.shape
        )
        permuted = tagged[self._order][:, self._order].tocsc()
        permuted.sort_indices()
        self._source = permuted.data.astype(np.int64)
        self._permuted = permuted
        self.refactor(matrix.data)

    def refactor(self, values: np.ndarray) -> None:
        """Factor again with other values in the same places of the matrix."""
        self._permuted.data = values[self._source]
        try:
            self._lu = scipy.sparse.linalg.splu(
                self._permuted,
                permc_spec=self._column_order,
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise np.linalg.LinAlgError(
                f"the sparse matrix cannot be factored: {error}"
            ) from error

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        solution = np.empty_like(rhs)
        solution[self._order] = self._lu.solve(np.ascontiguousarray(rhs[self._order]))
        return solution


def _block_dissection(
    matrix: sp.csc_matrix, points: Float[np.ndarray, "k 3"]
) -> Int[np.ndarray, " n"]:
    block, rest = divmod(matrix.shape[0], len(points))
    if rest:
        raise ValueError(f"{matrix.shape[0]} unknowns do not sit at {len(points)} points evenly")
    order = nested_dissection(matrix[::block][:, ::block].tocsr(), points)
    return (order[:, None] * block + np.arange(block)).reshape(-1)


def nested_dissection(
    graph: sp.csr_matrix, points: Float[np.ndarray, "n 3"]
) -> Int[np.ndarray, " n"]:
    """Elimination order of a mesh graph: halves first, the vertices between them last.

    Every part is cut at the median of its widest direction; its separator is the near side of the
    cut. Fill is O(n log n) on surface meshes (George 1973).
    """
    order: list[np.ndarray] = []
    across = np.zeros(graph.shape[0], dtype=bool)
    pending = [(np.arange(graph.shape[0]), False)]
    while pending:
        part, whole = pending.pop()
        if whole or len(part) <= _LEAF:
            order.append(part)
            continue
        near, separator, far = _cut(graph, points, part, across)
        # The stack hands out the halves before the separator that was put below them.
        pending += [(separator, True), (far, False), (near, False)]
    return np.concatenate(order).astype(np.int64)


def _cut(
    graph: sp.csr_matrix, points: np.ndarray, part: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    centred = points[part] - points[part].mean(axis=0)
    widest = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    rank = np.argsort(centred @ widest, kind="stable")
    near, far = part[rank[: len(part) // 2]], part[rank[len(part) // 2 :]]
    across[far] = True
    rows = graph[near]
    touches = np.add.reduceat(across[rows.indices], rows.indptr[:-1]) > 0
    across[far] = False
    return near[~touches], near[touches], far
