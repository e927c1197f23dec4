"""Non-rigid registration with an as-rigid-as-possible prior (paper App. B.3).

A source mesh is bent onto a target by alternating closest points, local rotations and one sparse
solve, from stiff to soft. The rest shape is the source for the whole edge, interpolants included:
resetting it along the way lets the distortion of every leg through (measured, `docs/paper.md`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from gensp.errors import RegistrationFailed
from gensp.geometry.arap import ArapSystem
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import SPHERE_AREA, Mesh
from gensp.geometry.points import SurfacePoints

Schedule = tuple[tuple[float, int], ...]


@dataclass(frozen=True)
class RegistrationSettings:
    """Numbers of one registration; lengths are for shapes of area 4π and scale with the target.

    Attributes
    ----------
    schedule
        (ARAP stiffness, steps) from stiff to soft, towards the target itself.
    approach
        The same towards every interpolant.
    interpolants
        Level sets between source and target that the caller is asked for.
    normal_agreement
        Closest points whose normals have a smaller dot product do not pull.
    outlier_scale, outlier_floor
        A pull over distance d weighs 1/(1 + (d/ℓ)²) with ℓ = scale · median(d) + floor.
    two_sided
        The target's vertices pull their nearest source points too, so that limbs are reached.
    relaxation, relaxation_until
        Every step is lengthened by this factor while the stiffness is at least `relaxation_until`:
        alternating local and global steps creep where the prior is stiff.
    damping
        Weight of staying where the step began; it only fixes what nothing else pulls.
    tolerance
        Converged when the root mean square motion of the last step is below it.
    """

    schedule: Schedule = (
        (100.0, 10),
        (30.0, 5),
        (10.0, 5),
        (3.0, 4),
        (1.0, 4),
        (0.3, 3),
        (0.1, 3),
    )
    approach: Schedule = ((10.0, 2), (3.0, 2), (1.0, 2))
    interpolants: int = 0
    normal_agreement: float = 0.4
    outlier_scale: float = 3.0
    outlier_floor: float = 0.02
    two_sided: bool = True
    relaxation: float = 1.7
    relaxation_until: float = 1.0
    damping: float = 1e-6
    tolerance: float = 0.01


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
    """

    vertices: Float[np.ndarray, "n 3"]
    residual: float
    residual_max: float
    coverage: float
    coverage_max: float
    fold_rate: float
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
    source: Mesh, targets: Sequence[Mesh], *, settings: RegistrationSettings | None = None
) -> Registration:
    """Bend `source` through the interpolants onto the last of `targets`.

    Returns positions for the source's own vertices: the target remeshed with the connectivity
    of the source. Both must already lie in a common frame.
    """
    settings = settings or RegistrationSettings()
    bending = _Bending(source, settings)
    vertices, motion, steps = source.vertices, np.inf, 0
    for left, target in zip(reversed(range(len(targets))), targets, strict=True):
        pulls = _Pulls(target, settings)
        schedule = settings.approach if left else settings.schedule
        for stiffness in _steps(schedule):
            previous = vertices
            vertices = bending.step(previous, pulls(source.with_vertices(previous)), stiffness)
            motion = float(np.sqrt(np.square(vertices - previous).sum(axis=1).mean()))
            steps += 1
    converged = motion <= settings.tolerance * _size(targets[-1])
    return _assess(source.with_vertices(vertices), targets[-1], converged, steps)


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
        yield from [stiffness] * count


def _size(mesh: Mesh) -> float:
    return float(np.sqrt(mesh.area / SPHERE_AREA))


@dataclass(frozen=True)
class _Pull:
    """Points of the moving mesh drawn to fixed positions with weights."""

    at: SurfacePoints
    positions: Float[np.ndarray, "k 3"]
    weights: Float[np.ndarray, " k"]


class _Pulls:
    """Closest-point pulls towards one target, both ways."""

    def __init__(self, target: Mesh, settings: RegistrationSettings) -> None:
        self._target, self._settings, self._size = target, settings, _size(target)
        self._tree = ClosestPointTree(target)

    def __call__(self, moving: Mesh) -> list[_Pull]:
        found = self._tree.query(moving.vertices)
        normals = found.at.on(self._target.vertex_normals, self._target.faces)
        agree = _agree(moving.vertex_normals, normals, self._settings)
        weights = agree * self._robust(found.distance)
        pulls = [_Pull(_corners(moving), found.points, weights)]
        return [*pulls, self._reverse(moving)] if self._settings.two_sided else pulls

    def _reverse(self, moving: Mesh) -> _Pull:
        found = ClosestPointTree(moving).query(self._target.vertices)
        normals = found.at.on(moving.vertex_normals, moving.faces)
        agree = _agree(self._target.vertex_normals, normals, self._settings)
        # Both directions weigh the same whatever the two resolutions are.
        share = len(moving.vertices) / len(self._target.vertices)
        weights = share * agree * self._robust(found.distance)
        return _Pull(found.at, self._target.vertices, weights)

    def _robust(self, distance: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        floor = self._settings.outlier_floor * self._size
        limit = self._settings.outlier_scale * np.median(distance) + floor
        return 1 / (1 + np.square(distance / limit))


def _agree(
    a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"], settings: RegistrationSettings
) -> Bool[np.ndarray, " k"]:
    return np.einsum("kj,kj->k", a, b) > settings.normal_agreement


def _corners(mesh: Mesh) -> SurfacePoints:
    """Every vertex as a point of one of its faces."""
    face = np.empty(len(mesh.vertices), dtype=np.int64)
    face[mesh.faces] = np.arange(len(mesh.faces))[:, None]
    here = mesh.faces[face] == np.arange(len(face))[:, None]
    return SurfacePoints(face, here.astype(np.float64))


class _Bending:
    """The sparse system of one edge: stiffness · ARAP Laplacian + Σ w b bᵀ of the pulls.

    A pull touches the three corners of one face, which are neighbours: the pattern is the
    Laplacian's at every step, so that the symbolic factorisation is made once.
    """

    def __init__(self, source: Mesh, settings: RegistrationSettings) -> None:
        self._arap, self._faces, self._settings = ArapSystem(source), source.faces, settings
        n = self._count = len(source.vertices)
        self._name = source.name
        laplacian = self._arap.laplacian.tocoo()
        blocks = source.faces[:, :, None] * n + source.faces[:, None, :]
        entries = laplacian.col.astype(np.int64) * n + laplacian.row
        keys, slots = np.unique(np.concatenate([blocks.reshape(-1), entries]), return_inverse=True)
        self._slots = slots[: blocks.size].reshape(-1, 3, 3)
        self._rows, self._starts = keys % n, np.searchsorted(keys, np.arange(n + 1) * n)
        self._laplacian = np.bincount(
            slots[blocks.size :], weights=laplacian.data, minlength=len(keys)
        )
        self._diagonal = np.searchsorted(keys, np.arange(n) * (n + 1))
        everywhere = _Pull(_corners(source), source.vertices, np.ones(n))
        self._solver = SPDSolver(self._matrix([everywhere], 1.0), source.vertices)

    def step(
        self, vertices: Float[np.ndarray, "n 3"], pulls: Sequence[_Pull], stiffness: float
    ) -> Float[np.ndarray, "n 3"]:
        """One rigid, one local and one global step from `vertices`."""
        try:
            start = _moved_rigidly(vertices, pulls, self._faces)
            self._solver.refactor(self._matrix(pulls, stiffness))
            end = self._solver.solve(self._right_side(start, pulls, stiffness))
        except np.linalg.LinAlgError as error:
            raise RegistrationFailed(
                f"{self._name}: the registration diverged at stiffness {stiffness:g} ({error}); "
                "shapes in a common frame without degenerate triangles are required; start "
                "stiffer with recipe.correspond.registration.schedule"
            ) from error
        relaxed = stiffness >= self._settings.relaxation_until
        return start + (self._settings.relaxation if relaxed else 1.0) * (end - start)

    def _right_side(
        self, start: Float[np.ndarray, "n 3"], pulls: Sequence[_Pull], stiffness: float
    ) -> Float[np.ndarray, "n 3"]:
        right = stiffness * self._arap.rhs(self._arap.rotations(start))
        for pull in pulls:
            right += self._scattered(pull)
        return right + self._settings.damping * start

    def _matrix(self, pulls: Sequence[_Pull], stiffness: float) -> sp.csc_matrix:
        data = stiffness * self._laplacian
        data[self._diagonal] += self._settings.damping
        for pull in pulls:
            b = pull.at.barycentric
            blocks = pull.weights[:, None, None] * b[:, :, None] * b[:, None, :]
            slots = self._slots[pull.at.faces].reshape(-1)
            data += np.bincount(slots, weights=blocks.reshape(-1), minlength=len(data))
        shape = (self._count, self._count)
        return sp.csc_matrix((data, self._rows, self._starts), shape=shape)

    def _scattered(self, pull: _Pull) -> Float[np.ndarray, "n 3"]:
        corners = self._faces[pull.at.faces].reshape(-1)
        weights = (pull.weights[:, None] * pull.at.barycentric).reshape(-1)
        wanted = np.repeat(pull.positions, 3, axis=0) * weights[:, None]
        columns = [np.bincount(corners, wanted[:, k], self._count) for k in range(3)]
        return np.stack(columns, axis=1)


def _moved_rigidly(
    vertices: Float[np.ndarray, "n 3"], pulls: Sequence[_Pull], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Best rigid motion under the pulls (Procrustes): stiff local steps would take long for it."""
    at = np.concatenate([pull.at.on(vertices, faces) for pull in pulls])
    wanted = np.concatenate([pull.positions for pull in pulls])
    weights = np.concatenate([pull.weights for pull in pulls])
    if weights.sum() == 0:
        return vertices
    weights = weights / weights.sum()
    here, there = weights @ at, weights @ wanted
    u, _, vt = np.linalg.svd(((at - here) * weights[:, None]).T @ (wanted - there))
    proper = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return (vertices - here) @ (u * proper @ vt) + there


def _assess(moved: Mesh, target: Mesh, converged: bool, iterations: int) -> Registration:
    size, tree = _size(target), ClosestPointTree(target)
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
        converged=bool(converged and np.isfinite(moved.vertices).all()),
        iterations=iterations,
    )


def folded(moved: Mesh, normals: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    """Faces that oppose the given surface normals, or have no area."""
    return np.einsum("mj,mj->m", moved.face_normals, normals) <= 0
