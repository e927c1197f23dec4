"""Non-rigid registration with an as-rigid-as-possible prior (paper App. B.2).

A source mesh is bent onto a target by alternating closest points, local rotations and one sparse
solve, from stiff to soft. The rest shape is the source for the whole edge, interpolants included:
resetting it along the way lets the distortion of every leg through (measured, `docs/paper.md`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from gensp.errors import RegistrationFailed
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration_step import (
    BendingSystem,
    ClosestPointPulls,
    RegistrationSettings,
    Schedule,
    scale_of,
)

__all__ = [
    "Acceptance",
    "Attempts",
    "Registration",
    "RegistrationSettings",
    "approached",
    "folded",
    "register",
    "register_with_retries",
]


@dataclass(frozen=True)
class Registration:
    """The source's vertices on the target, and how well they got there.

    Distances are divided by the target's √(area/4π).

    Attributes
    ----------
    residual, residual_max
        Distance of the registered vertices to the target.
    coverage, coverage_max
        Distance of the target's vertices to the registered surface: a missed limb shows here.
    fold_rate
        Share of registered faces that oppose the target's normal or have no area.
    strain
        ARAP energy over that of collapsing the source to a point: what the bending cost. Of two
        registrations that both fit, the less strained one is nearer to the true correspondence.
    """

    vertices: Float[np.ndarray, "n 3"]
    residual: float
    residual_max: float
    coverage: float
    coverage_max: float
    fold_rate: float
    strain: float
    converged: bool
    iterations: int


@dataclass(frozen=True)
class Acceptance:
    """What a registration must reach to be used; lengths for shapes of area 4π."""

    residual: float = 0.03
    coverage: float = 0.03
    fold_rate: float = 0.05

    def complaint(self, result: Registration) -> str:
        """Name what misses its bound; empty when the registration may be used."""
        names = ("residual", "coverage", "fold_rate")
        missed = [
            f"{name} {getattr(result, name):.3g} above {getattr(self, name):.3g}"
            for name in names
            if not getattr(result, name) <= getattr(self, name)
        ]
        return ", ".join(missed + ([] if result.converged else ["not converged"]))


@dataclass(frozen=True)
class Attempts:
    """The best registration of a retry ladder, and what was found wrong on every rung tried."""

    best: Registration
    complaints: tuple[str, ...] = field(default=())

    @property
    def accepted(self) -> bool:
        """Whether the last rung tried met the bounds."""
        return self.complaints[-1] == ""


def register(
    source: Mesh,
    targets: Sequence[Mesh],
    *,
    settings: RegistrationSettings | None = None,
    start: Float[np.ndarray, "n 3"] | None = None,
) -> Registration:
    """Bend `source` through the interpolants onto the last of `targets`.

    Returns positions for the source's own vertices: the target remeshed with the connectivity
    of the source. Both must already lie in a common frame. `start` are positions of the source's
    vertices to begin at; the source itself stays the shape that is bent as little as possible.
    """
    settings = settings or RegistrationSettings()
    bending = BendingSystem(source, settings)
    return approached(
        source, targets, settings, bending, source.vertices if start is None else start
    )


def approached(
    source: Mesh,
    targets: Sequence[Mesh],
    settings: RegistrationSettings,
    bending: BendingSystem,
    start: Float[np.ndarray, "n 3"],
) -> Registration:
    """`register` with the source's system at hand: several starts share it."""
    vertices, motion, steps = start, np.inf, 0
    for left, target in zip(reversed(range(len(targets))), targets, strict=True):
        pulls = ClosestPointPulls(target, settings)
        schedule = settings.approach if left else settings.schedule
        for stiffness in _steps(schedule):
            previous = vertices
            vertices = bending.step(previous, pulls(source.with_vertices(previous)), stiffness)
            motion = float(np.sqrt(np.square(vertices - previous).sum(axis=1).mean()))
            steps += 1
    converged = motion <= settings.tolerance * scale_of(targets[-1])
    moved = source.with_vertices(vertices)
    return _assess(moved, targets[-1], bending.strain(vertices), converged, steps)


def register_with_retries(
    source: Mesh,
    target: Mesh,
    *,
    ladder: Sequence[RegistrationSettings],
    acceptance: Acceptance,
    interpolate: Callable[[int], Sequence[Mesh]] = lambda count: (),
) -> Attempts:
    """Try the ladder's settings in turn until a registration meets the bounds.

    `interpolate(n)` supplies n level sets between source and target. Without success the
    attempt that fits best is returned, marked as not accepted.

    Raises
    ------
    RegistrationFailed
        Every attempt diverged.
    """
    results, complaints = [], []
    for settings in ladder:
        between = interpolate(settings.interpolants) if settings.interpolants else ()
        try:
            results.append(register(source, [*between, target], settings=settings))
        except RegistrationFailed as error:
            complaints.append(str(error))
            continue
        complaints.append(acceptance.complaint(results[-1]))
        if complaints[-1] == "":
            return Attempts(results[-1], tuple(complaints))
    if not results:
        raise RegistrationFailed(complaints[-1])
    best = min(results, key=lambda result: result.residual + result.coverage)
    return Attempts(best, tuple(complaints))


def _steps(schedule: Schedule) -> Iterator[float]:
    for stiffness, count in schedule:
        yield from [stiffness] * int(count)


def _assess(
    moved: Mesh, target: Mesh, strain: float, converged: bool, iterations: int
) -> Registration:
    size, tree = scale_of(target), ClosestPointTree(target)
    residual = tree.query(moved.vertices).distance / size
    coverage = ClosestPointTree(moved).query(target.vertices).distance / size
    centres = tree.query(moved.vertices[moved.faces].mean(axis=1))
    return Registration(
        vertices=moved.vertices,
        residual=float(residual.mean()),
        residual_max=float(residual.max()),
        coverage=float(coverage.mean()),
        coverage_max=float(coverage.max()),
        fold_rate=float(folded(moved, target.face_normals[centres.at.faces]).mean()),
        strain=strain,
        converged=bool(converged and np.isfinite(moved.vertices).all()),
        iterations=iterations,
    )


def folded(moved: Mesh, normals: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    """Faces that oppose the given surface normals, or have no area."""
    return np.einsum("mj,mj->m", moved.face_normals, normals) <= 0
