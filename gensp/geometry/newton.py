"""Projected Newton on the sphere: the least distorted map near a start, without folds."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from jaxtyping import Float

from gensp.errors import NotEmbeddable
from gensp.geometry.assembly import HessianPattern
from gensp.geometry.descent import minimised
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import lumped_mass
from gensp.geometry.predicates import (
    bad_faces,
    map_degree,
    signed_preimages,
    spherical_orientation,
)
from gensp.geometry.sphere import tangent_frame, unit
from gensp.geometry.spherical_energy import SphericalEnergy, project_positive

_RIDGE = 1e-6  # times the vertex areas: holds the three rotations where nothing pulls


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
    detour: bool = False,
) -> Refined:
    """`minimise_map` with a distortion energy of `compiled.energies.ENERGIES`.

    Parameters
    ----------
    weights
        Factor of every triangle in E, one by default.
    energy
        Name of E.
    detour
        Where the minimisation does not converge, try again from the same start by way of the
        symmetric Dirichlet energy, which is less steep where a triangle is nearly collapsed. The
        lower of both results is taken, and their iterations are added up: three times
        `max_iterations` at most.

    Raises
    ------
    NotEmbeddable
        The start has bad faces.
    """
    minimise = partial(
        minimise_map,
        mesh,
        target=start if target is None else target,
        pull=pull,
        max_iterations=max_iterations,
        tolerance=tolerance,
    )
    wanted = SphericalEnergy(mesh, weights, energy)
    direct = minimise(start, wanted)
    if direct.converged or not detour or energy == "dirichlet":
        return direct
    return _by_way_of(minimise, start, direct, SphericalEnergy(mesh, weights), wanted)


def _by_way_of(
    minimise: Callable[..., Refined],
    start: Float[np.ndarray, "n 3"],
    direct: Refined,
    milder: MapEnergy,
    wanted: MapEnergy,
) -> Refined:
    """The lower of the direct result and that by way of a milder energy; iterations of all."""
    first = minimise(start, milder)
    try:
        second = minimise(first.sphere, wanted)
    except NotEmbeddable:  # the last digits of a face that is hardly there
        return direct
    made = direct.iterations + first.iterations + second.iterations
    return replace(min(direct, second, key=lambda found: found.energy), iterations=made)


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
    """As `refine_map`, of any energy E of maps of the mesh; the degree stays that of the start.

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
    goal = u if target is None else unit(target)
    problem = _PulledEnergy(mesh, energy, side * u, side * goal, pull)
    found = minimised(problem, side * u, max_iterations, relative=tolerance, absolute=decrement)
    return Refined(side * found.positions, found.energy, found.iterations, found.converged)


class _PulledEnergy:
    """E(u) + Σ γ_i M_i ‖u_i − u⁰_i‖² and its derivatives in the tangent planes."""

    def __init__(
        self,
        mesh: Mesh,
        distortion: MapEnergy,
        start: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"],
        pull: float | Float[np.ndarray, " n"],
    ) -> None:
        self.points, self.faces, self.target = mesh.vertices, mesh.faces, target
        self.distortion, self.degree = distortion, map_degree(start, mesh.faces)
        areas = lumped_mass(mesh.vertices, mesh.faces)
        self.spring = areas * pull
        self.ridge = areas * _RIDGE
        self.pattern = HessianPattern(mesh.faces, len(areas))

    def value(self, u: Float[np.ndarray, "n 3"]) -> float:
        away = np.sum((u - self.target) ** 2, axis=1)
        return self.distortion.energy(u) + float(self.spring @ away)

    def derivatives(
        self, u: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " k"], scipy.sparse.csc_matrix]:
        """Gradient and Hessian in tangent frames, every triangle's part of it made positive."""
        frames = tangent_frame(u)
        free = self.distortion.gradient(u) + 2 * self.spring[:, None] * (u - self.target)
        gradient = np.einsum("nik,ni->nk", frames, free).reshape(-1)
        blocks = project_positive(self.distortion.hessians(u, frames))
        # ‖u − u⁰‖² = 2 − 2 u·u⁰ on the sphere has the Hessian 2 (u·u⁰) I.
        aligned = np.maximum(np.einsum("ni,ni->n", u, self.target), 0)
        diagonal = 2 * self.spring * aligned + self.ridge
        return gradient, self.pattern.assemble(blocks, np.repeat(diagonal, 2))

    def path(
        self, u: Float[np.ndarray, "n 3"], step: Float[np.ndarray, " k"]
    ) -> Callable[[float], Float[np.ndarray, "n 3"]]:
        direction = np.einsum("nik,nk->ni", tangent_frame(u), step.reshape(-1, 2))
        return lambda part: unit(u + part * direction)

    def folds(self, u: Float[np.ndarray, "n 3"]) -> bool:
        orientation = spherical_orientation(u, self.faces)
        if (orientation <= 0).any():
            return True
        # A long step can wind a ring twice around its vertex with every face the right way round.
        return signed_preimages(u, self.faces, orientation) != self.degree
