"""One step of a non-rigid registration: pulls towards the target, and the sparse system."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from gensp.errors import RegistrationFailed
from gensp.geometry.arap import ArapSystem
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import SPHERE_AREA, Mesh
from gensp.geometry.points import SurfacePoints

Schedule = Sequence[Sequence[float | int]]


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
        A pull over distance d weighs 1/(1 + (d/ℓ)²) with ℓ = scale · median(d) + floor. Closed
        shapes hold no outliers: a small floor only gives up growing limbs.
    two_sided
        The target's vertices pull their nearest source points too, so that limbs are reached.
    relaxation, relaxation_until
        Every step is lengthened by this factor while the stiffness is at least `relaxation_until`:
        alternating local and global steps creep where the prior is stiff.
    damping
        Weight of staying where the step began; it only fixes what nothing else pulls.
    tolerance
        Converged when the root mean square motion of the last step is below it.
    posing
        (ARAP stiffness, steps) towards the positions of a guide, before closest points pull.
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
    outlier_floor: float = 0.2
    two_sided: bool = True
    relaxation: float = 1.7
    relaxation_until: float = 1.0
    damping: float = 1e-6
    tolerance: float = 0.01
    posing: Schedule = ((100.0, 20), (30.0, 10))


def scale_of(mesh: Mesh) -> float:
    """Length unit √(area / 4π): 1 for a normalised shape."""
    return float(np.sqrt(mesh.area / SPHERE_AREA))


@dataclass(frozen=True)
class Pull:
    """Points of the moving mesh drawn to fixed positions with weights."""

    at: SurfacePoints
    positions: Float[np.ndarray, "k 3"]
    weights: Float[np.ndarray, " k"]


class ClosestPointPulls:
    """Closest-point pulls towards one target, both ways."""

    def __init__(self, target: Mesh, settings: RegistrationSettings) -> None:
        self._target, self._settings, self._size = target, settings, scale_of(target)
        self._tree = ClosestPointTree(target)

    def __call__(self, moving: Mesh) -> list[Pull]:
        """Pulls on the mesh as it stands."""
        found = self._tree.query(moving.vertices)
        normals = found.at.on(self._target.vertex_normals, self._target.faces)
        agree = _agree(moving.vertex_normals, normals, self._settings)
        weights = agree * self._robust(found.distance)
        pulls = [Pull(corners(moving), found.points, weights)]
        return [*pulls, self._reverse(moving)] if self._settings.two_sided else pulls

    def _reverse(self, moving: Mesh) -> Pull:
        found = ClosestPointTree(moving).query(self._target.vertices)
        normals = found.at.on(moving.vertex_normals, moving.faces)
        agree = _agree(self._target.vertex_normals, normals, self._settings)
        # Both directions weigh the same whatever the two resolutions are.
        share = len(moving.vertices) / len(self._target.vertices)
        weights = share * agree * self._robust(found.distance)
        return Pull(found.at, self._target.vertices, weights)

    def _robust(self, distance: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        floor = self._settings.outlier_floor * self._size
        limit = self._settings.outlier_scale * np.median(distance) + floor
        return 1 / (1 + np.square(distance / limit))


def _agree(
    a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"], settings: RegistrationSettings
) -> Bool[np.ndarray, " k"]:
    return np.einsum("kj,kj->k", a, b) > settings.normal_agreement


def corners(mesh: Mesh) -> SurfacePoints:
    """Every vertex as a point of one of its faces."""
    face = np.empty(len(mesh.vertices), dtype=np.int64)
    face[mesh.faces] = np.arange(len(mesh.faces))[:, None]
    here = mesh.faces[face] == np.arange(len(face))[:, None]
    return SurfacePoints(face, here.astype(np.float64))


class BendingSystem:
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
        self.corners = corners(source)
        everywhere = Pull(self.corners, source.vertices, np.ones(n))
        try:
            self._solver = SPDSolver(self._matrix([everywhere], 1.0), source.vertices)
        except np.linalg.LinAlgError as error:
            flat = int((source.face_areas <= 0).sum())
            raise RegistrationFailed(
                f"{source.name}: the source of the registration cannot be bent ({error}); "
                f"triangles with area are required, {flat} have none; remesh it"
            ) from error

    def step(
        self, vertices: Float[np.ndarray, "n 3"], pulls: Sequence[Pull], stiffness: float
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

    def strain(self, vertices: Float[np.ndarray, "n 3"]) -> float:
        """ARAP energy of bent vertices over the energy of collapsing the source to a point."""
        return self._arap.energy(vertices) / self._arap.edge_energy

    def _right_side(
        self, start: Float[np.ndarray, "n 3"], pulls: Sequence[Pull], stiffness: float
    ) -> Float[np.ndarray, "n 3"]:
        right = stiffness * self._arap.rhs(self._arap.rotations(start))
        for pull in pulls:
            right += self._scattered(pull)
        return right + self._settings.damping * start

    def _matrix(self, pulls: Sequence[Pull], stiffness: float) -> sp.csc_matrix:
        data = stiffness * self._laplacian
        data[self._diagonal] += self._settings.damping
        for pull in pulls:
            b = pull.at.barycentric
            blocks = pull.weights[:, None, None] * b[:, :, None] * b[:, None, :]
            slots = self._slots[pull.at.faces].reshape(-1)
            data += np.bincount(slots, weights=blocks.reshape(-1), minlength=len(data))
        shape = (self._count, self._count)
        return sp.csc_matrix((data, self._rows, self._starts), shape=shape)

    def _scattered(self, pull: Pull) -> Float[np.ndarray, "n 3"]:
        corners = self._faces[pull.at.faces].reshape(-1)
        weights = (pull.weights[:, None] * pull.at.barycentric).reshape(-1)
        wanted = np.repeat(pull.positions, 3, axis=0) * weights[:, None]
        columns = [np.bincount(corners, wanted[:, k], self._count) for k in range(3)]
        return np.stack(columns, axis=1)


def _moved_rigidly(
    vertices: Float[np.ndarray, "n 3"], pulls: Sequence[Pull], faces: Int[np.ndarray, "m 3"]
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
