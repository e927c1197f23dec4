"""Sparse symmetric positive definite systems, factored once or once per change of values.

Up to about ten thousand unknowns a simplicial L D Lᵀ whose symbolic analysis is kept (qdldl) is
fastest; above, dense blocks pay (`multifrontal`).
"""

from typing import Protocol, runtime_checkable

import numpy as np
import qdldl
import scipy.sparse as sp
from jaxtyping import Float

MULTIFRONTAL_FROM = 15_000  # unknowns


@runtime_checkable
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
        With them large systems are dissected; without, all are treated as small ones.

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
            if points is None or matrix.shape[0] < MULTIFRONTAL_FROM
            else _multifrontal(matrix, points)
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


def _multifrontal(matrix: sp.csc_matrix, points: np.ndarray) -> _Factor:
    # Small systems need no compiled loops.
    from gensp.geometry.multifrontal import MultifrontalCholesky

    return MultifrontalCholesky(matrix, points)


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
