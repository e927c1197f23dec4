"""Newton's method with a line search for energies of maps that are infinite where one folds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from jaxtyping import Float

from gensp.geometry.linear import SPDSolver, factored
from gensp.geometry.progress import tell

_SUFFICIENT = 1e-4  # Armijo: part of the predicted decrease that a step must reach
_SHRINK = 0.5
_MAX_HALVINGS = 50
_DAMPINGS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)

Positions = Float[np.ndarray, "n d"]


@runtime_checkable
class Problem(Protocol):
    """An energy of the positions of n vertices, and the way a step moves them.

    Attributes
    ----------
    points
        Positions (n, 3) on the surface, by which large matrices are dissected.
    """

    points: Float[np.ndarray, "n 3"]

    def value(self, x: Positions) -> float:
        """The energy; infinite where a triangle folds."""
        ...

    def derivatives(self, x: Positions) -> tuple[Float[np.ndarray, " k"], scipy.sparse.csc_matrix]:
        """Gradient, and a Hessian whose parts are positive, by the unknowns of a step."""
        ...

    def path(self, x: Positions, step: Float[np.ndarray, " k"]) -> Callable[[float], Positions]:
        """Positions after a part of the step."""
        ...

    def folds(self, x: Positions) -> bool:
        """Whether the map is folded in a way that the energy does not see."""
        ...


@dataclass(frozen=True)
class Minimum:
    """Positions, their energy, and how the minimisation ended."""

    positions: Positions
    energy: float
    iterations: int
    converged: bool


def minimised(
    problem: Problem,
    x: Positions,
    max_iterations: int,
    *,
    relative: float = 0.0,
    absolute: float = 0.0,
) -> Minimum:
    """Newton steps until the quadratic model promises too small a decrease of the energy.

    Parameters
    ----------
    relative, absolute
        That decrease, over the energy and by itself.
    """
    value, solver = problem.value(x), None
    for iteration in range(max_iterations):
        tell(f"Newton step {iteration + 1} of at most {max_iterations}, {len(x)} vertices")
        try:
            gradient, hessian = problem.derivatives(x)
            step, solver = newton_step(hessian, gradient, problem.points, solver)
        except np.linalg.LinAlgError:
            # Vertices fell together, or triangles are so small that the matrix has no digits left:
            # the map is as good as it gets.
            return Minimum(x, value, iteration, False)
        slope = float(gradient @ step)
        found = _line_search(problem, problem.path(x, step), value, slope)
        if found is None:
            return Minimum(x, value, iteration, False)
        x, value = found
        # Half the slope is the decrease that the quadratic model promises: unlike the decrease
        # itself it is not small merely because a fold was near.
        if -0.5 * slope <= max(relative * value, absolute):
            return Minimum(x, value, iteration + 1, True)
    return Minimum(x, value, max_iterations, False)


def newton_step(
    hessian: scipy.sparse.csc_matrix,
    gradient: Float[np.ndarray, " k"],
    points: Float[np.ndarray, "n 3"],
    solver: SPDSolver | None = None,
) -> tuple[Float[np.ndarray, " k"], SPDSolver]:
    """A direction of descent −H⁻¹g, and the solver of H's pattern for the next one.

    Near a collapse entries differ by so many orders that H loses definiteness to rounding. Its
    diagonal is then raised, by as little as makes the step one of descent.

    Raises
    ------
    numpy.linalg.LinAlgError
        None does.
    """
    for damping in _DAMPINGS:
        raised = scipy.sparse.diags(damping * hessian.diagonal(), format="csc")
        try:
            solver = factored(solver, hessian + raised if damping else hessian, points)
            step = -solver.solve(gradient)
        except np.linalg.LinAlgError:
            continue
        if gradient @ step < 0 or not gradient.any():
            return step, solver
    raise np.linalg.LinAlgError("no step of descent was found: the matrix has no digits left")


def _line_search(
    problem: Problem, path: Callable[[float], Positions], value: float, slope: float
) -> tuple[Positions, float] | None:
    """Longest halved step that decreases the energy enough and folds nothing."""
    step = 1.0
    for _ in range(_MAX_HALVINGS):
        moved = path(step)
        reached = problem.value(moved)
        # The energy is a barrier only up to rounding; `folds` has the last word.
        if reached <= value + _SUFFICIENT * step * slope and not problem.folds(moved):
            return moved, reached
        step *= _SHRINK
    return None
