"""Projected Newton on the sphere: the least distorted map near a start, without folds."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from jaxtyping import Float

from gensp.errors import NotEmbeddable
from gensp.geometry.assembly import HessianPattern
from gensp.geometry.linear import SPDSolver, factored
from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import bad_faces, spherical_orientation
from gensp.geometry.progress import tell
from gensp.geometry.sphere import tangent_frame, unit
from gensp.geometry.spherical_energy import SphericalEnergy, project_positive

_RIDGE = 1e-6  # times the vertex areas: holds the three rotations where nothing pulls
_SUFFICIENT = 1e-4  # Armijo: part of the predicted decrease that a step must reach
_SHRINK = 0.5
_MAX_HALVINGS = 50
_DAMPINGS = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)


@runtime_checkable
class MapEnergy(Protocol):
    """Energy of maps to the sphere: a sum over triangles, infinite where one folds."""

    def energy(self, u: Float[np.ndarray, "n 3"]) -> float:
        """Its value."""
        ...

    def gradient(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Its derivative by the positions as free vectors of space."""
        ...

    def hessians(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """Riemannian Hessian of every triangle's term, in the tangent frames of its corners."""
        ...


@dataclass(frozen=True)
class Refined:
    """A refined map: unit positions (n, 3), its energy, and how the minimisation ended."""

    sphere: Float[np.ndarray, "n 3"]
    energy: float
    iterations: int
    converged: bool


def refine_map(
    mesh: Mesh,
    start: Float[np.ndarray, "n 3"],
    *,
    target: Float[np.ndarray, "n 3"] | None = None,
    pull: float | Float[np.ndarray, " n"] = 0.0,
    max_iterations: int = 50,
    tolerance: float = 1e-4,
    weights: Float[np.ndarray, " m"] | None = None,
    energy: str = "dirichlet",
) -> Refined:
    """`minimise_map` with a distortion energy of `compiled.energies.ENERGIES`.

    Parameters
    ----------
    weights
        Factor of every triangle in E, one by default.
    energy
        Name of E.

    Raises
    ------
    NotEmbeddable
        The start has bad faces.
    """
    return minimise_map(
        mesh,
        start,
        SphericalEnergy(mesh, weights, energy),
        target=target,
        pull=pull,
        max_iterations=max_iterations,
        tolerance=tolerance,
    )


def minimise_map(
    mesh: Mesh,
    start: Float[np.ndarray, "n 3"],
    energy: MapEnergy,
    *,
    target: Float[np.ndarray, "n 3"] | None = None,
    pull: float | Float[np.ndarray, " n"] = 0.0,
    max_iterations: int = 50,
    tolerance: float = 1e-4,
    decrement: float = 0.0,
) -> Refined:
    """As `refine_map`, of any energy E of maps of the mesh.

    Parameters
    ----------
    decrement
        Absolute decrease of the energy, as the quadratic model promises it, to stop at.

    Raises
    ------
    NotEmbeddable
        The start has bad faces.
    """
    u = unit(start)
    bad = int(bad_faces(u, mesh.faces).sum())
    if bad:
        raise NotEmbeddable(
            f"{mesh.name}: the start of the refinement has {bad} bad faces; none is allowed; "
            "untangle it first"
        )
    # The antipodal map turns every orientation round: minimise there, and turn back.
    side = 1.0 if spherical_orientation(u, mesh.faces)[0] > 0 else -1.0
    problem = _PulledEnergy(mesh, energy, side * (u if target is None else unit(target)), pull)
    refined = _minimise(problem, side * u, max_iterations, (tolerance, decrement))
    return Refined(side * refined.sphere, refined.energy, refined.iterations, refined.converged)


class _PulledEnergy:
    """E(u) + Σ γ_i M_i ‖u_i − u⁰_i‖² and its derivatives in the tangent planes."""

    def __init__(
        self,
        mesh: Mesh,
        distortion: MapEnergy,
        target: Float[np.ndarray, "n 3"],
        pull: float | Float[np.ndarray, " n"],
    ) -> None:
        self.mesh, self.target = mesh, target
        self.distortion = distortion
        count = len(mesh.vertices)
        areas = np.bincount(mesh.faces.reshape(-1), np.repeat(mesh.face_areas / 3, 3), count)
        self.spring = areas * pull
        self.ridge = areas * _RIDGE
        self.pattern = HessianPattern(mesh.faces, count)

    def value(self, u: Float[np.ndarray, "n 3"]) -> float:
        away = np.sum((u - self.target) ** 2, axis=1)
        return self.distortion.energy(u) + float(self.spring @ away)

    def gradient(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> Float[np.ndarray, " k"]:
        free = self.distortion.gradient(u) + 2 * self.spring[:, None] * (u - self.target)
        return np.einsum("nik,ni->nk", frames, free).reshape(-1)

    def hessian(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> scipy.sparse.csc_matrix:
        """Of the energy, every triangle's part made positive, with springs and ridge."""
        blocks = project_positive(self.distortion.hessians(u, frames))
        # ‖u − u⁰‖² = 2 − 2 u·u⁰ on the sphere has the Hessian 2 (u·u⁰) I.
        aligned = np.maximum(np.einsum("ni,ni->n", u, self.target), 0)
        diagonal = 2 * self.spring * aligned + self.ridge
        return self.pattern.assemble(blocks, np.repeat(diagonal, 2))


def _minimise(
    problem: _PulledEnergy,
    u: Float[np.ndarray, "n 3"],
    max_iterations: int,
    tolerances: tuple[float, float],
) -> Refined:
    relative, absolute = tolerances
    value, solver = problem.value(u), None
    for iteration in range(max_iterations):
        tell(f"Newton step {iteration + 1} of at most {max_iterations}, {len(u)} vertices")
        frames = tangent_frame(u)
        try:
            gradient, hessian = problem.gradient(u, frames), problem.hessian(u, frames)
            step, solver = newton_step(hessian, gradient, problem.mesh.vertices, solver)
        except np.linalg.LinAlgError:
            # Vertices fell together, or triangles are so small that the matrix has no digits left:
            # the map is as good as it gets.
            return Refined(u, value, iteration, False)
        direction = np.einsum("nik,nk->ni", frames, step.reshape(-1, 2))
        slope = float(gradient @ step)
        found = _line_search(problem, u, direction, value, slope)
        if found is None:
            return Refined(u, value, iteration, False)
        u, value = found
        # Half the slope is the decrease that the quadratic model promises: unlike the decrease
        # itself it is not small merely because a fold was near.
        if -0.5 * slope <= max(relative * value, absolute):
            return Refined(u, value, iteration + 1, True)
    return Refined(u, value, max_iterations, False)


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
    problem: _PulledEnergy,
    u: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    value: float,
    slope: float,
) -> tuple[Float[np.ndarray, "n 3"], float] | None:
    """Longest halved step that decreases the energy enough and folds nothing."""
    step = 1.0
    for _ in range(_MAX_HALVINGS):
        moved = unit(u + step * direction)
        reached = problem.value(moved)
        # The energy is a barrier only up to rounding; the exact predicate has the last word.
        if reached <= value + _SUFFICIENT * step * slope and not _folds(problem.mesh, moved):
            return moved, reached
        step *= _SHRINK
    return None


def _folds(mesh: Mesh, u: Float[np.ndarray, "n 3"]) -> bool:
    return bool((spherical_orientation(u, mesh.faces) <= 0).any())
