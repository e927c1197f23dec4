"""Conformalised mean curvature flow to the sphere, and the score of a flow (paper §4.1, Eq. 1).

Source of the flow: Kazhdan, Solomon and Ben-Chen 2012, "Can mean-curvature flow be modified to be
non-singular?": the stiffness stays that of the input, the mass follows the moving shape.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from gensp.errors import DegenerateMesh
from gensp.geometry.arap import ArapSystem
from gensp.geometry.folds import folded_faces
from gensp.geometry.linear import factored
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.operators import (
    FullMass,
    cotangent_laplacian,
    delaunay_laplacian,
    lumped_mass,
)
from gensp.geometry.sphere import icosphere

# A triangle below this share of its first area (both shapes at 4π) no longer carries a shape.
SMALLEST_SHARE = 1e-6
_STILL = 5e-3
_SPHERE_LEVEL = 4

MassOf = Callable[[np.ndarray, np.ndarray], sp.csc_matrix]


@dataclass(frozen=True)
class StepSchedule:
    """Step sizes δ_k = min(first · growth^k, largest) of the flow; growth 1 is a constant."""

    first: float = 0.005
    growth: float = 1.2
    largest: float = 0.2

    def __call__(self, k: int) -> float:
        """Step size of step k."""
        # The exponent is bounded, as the power of a long flow would overflow.
        return min(self.first * self.growth ** min(k, 500), self.largest)

    def __str__(self) -> str:
        ramp = f"*{self.growth:g}^k<={self.largest:g}"
        return f"{self.first:g}" + (ramp if self.growth > 1 and self.first < self.largest else "")


@dataclass(frozen=True)
class Flow:
    """Shapes on the way from an input (first) to the sphere (last).

    Attributes
    ----------
    vertices
        Positions (t, n, 3), each centred with area 4π.
    times
        Accumulated step sizes (t,).
    arc_length
        Accumulated area-weighted root-mean-square displacement (t,).
    sphere_error
        max |‖x‖ − 1| of every shape (t,).
    converged, reason
        Whether the sphere was reached, and why the flow ended: "sphere", "stalled", "steps"
        or "degenerate: …".
    """

    vertices: Float[np.ndarray, "t n 3"]
    faces: Int[np.ndarray, "m 3"]
    times: Float[np.ndarray, " t"]
    arc_length: Float[np.ndarray, " t"]
    sphere_error: Float[np.ndarray, " t"]
    converged: bool
    reason: str

    @cached_property
    def sound(self) -> Bool[np.ndarray, " t"]:
        """Whether all triangles still carry area and none is folded.

        Where not, a shape is to be used as a geometry only, never with these faces. The first is
        the input, as it is.
        """
        first, *others = (Mesh(vertices, self.faces) for vertices in self.vertices)
        smallest = SMALLEST_SHARE * first.face_areas
        whole = (
            bool((s.face_areas > smallest).all() and not folded_faces(s).any()) for s in others
        )
        return np.array([True, *whole])

    def at(self, fractions: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k n 3"]:
        """Shapes at fractions in [0, 1] of the arc length, linear between steps."""
        # Ties (a flow that does not move) resolve to the first step.
        position = np.interp(
            np.clip(fractions, 0, 1) * self.arc_length[-1],
            self.arc_length,
            np.arange(len(self.arc_length), dtype=np.float64),
        )
        left = np.floor(position).astype(np.int64)
        right = np.minimum(left + 1, len(self.times) - 1)
        weight = (position - left)[:, None, None]
        return (1 - weight) * self.vertices[left] + weight * self.vertices[right]


def cmcf(
    mesh: Mesh,
    *,
    step: StepSchedule | None = None,
    max_steps: int = 100,
    tolerance: float = 0.015,
    intrinsic: bool = True,
    full: bool = False,
    patience: int | None = 10,
) -> Flow:
    """Flow a genus-0 mesh to the sphere: (M_t + δ L) x_{t+1} = M_t x_t, re-centred, area 4π.

    Parameters
    ----------
    mesh
        The input at any scale.
    step
        Step sizes.
    tolerance
        The flow ends when every vertex is this close to the unit sphere; resolution sets a floor
        of about 0.005.
    intrinsic
        Stiffness of the intrinsic Delaunay triangulation: no negative cotangents, hence fewer
        folds on the sphere. False is the plain cotangent matrix of the original.
    full
        The full mass matrix of linear elements, as in the authors' program; else the lumped one.
    patience
        The flow stalls after so many steps that hardly moved and came no closer to the sphere;
        with none it takes all of its steps, as the original does.

    Notes
    -----
    Limbs shrink to hairs and their triangles vanish; `sound` tells from where. The flow is cut
    before the first step that cannot be computed, and, where it stalls, at the closest one.

    Raises
    ------
    DegenerateMesh
        The input has no area, or not even the first step can be computed.
    """
    step, track = step or StepSchedule(), _Track(_at_area(mesh), patience)
    reason = _run(track, _matrices(track.shapes[0], intrinsic, full), step, max_steps, tolerance)
    if len(track.shapes) == 1:
        raise DegenerateMesh(f"{mesh.name}: {reason}; a mesh that can flow is required; remesh it")
    return track.flow(step, reason)


def _matrices(mesh: Mesh, intrinsic: bool, full: bool) -> tuple[sp.csc_matrix, MassOf]:
    """The stiffness, and the mass at any positions."""
    stiffness = delaunay_laplacian(mesh) if intrinsic else cotangent_laplacian(mesh)
    return stiffness, FullMass(mesh.faces, len(mesh.vertices)) if full else _lumped


def _lumped(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> sp.csc_matrix:
    return sp.diags(lumped_mass(vertices, faces), format="csc")


def _run(
    track: "_Track",
    matrices: tuple[sp.csc_matrix, MassOf],
    step: StepSchedule,
    max_steps: int,
    tolerance: float,
) -> str:
    """Take the steps of a flow; why it ended."""
    mesh, solver, (stiffness, mass_of) = track.shapes[0], None, matrices
    for k in range(max_steps):
        before = track.shapes[-1].vertices
        mass = mass_of(before, mesh.faces)
        try:
            solver = factored(solver, mass + step(k) * stiffness, mesh.vertices)
            shape = _renormalized(mesh, solver.solve(mass @ before))
        except (np.linalg.LinAlgError, DegenerateMesh) as error:
            return f"degenerate: {error}"
        # The rows of either mass add up to a third of the areas at the vertices.
        areas = np.asarray(mass.sum(axis=1)).reshape(-1)
        track.add(shape, _displacement(before, shape.vertices, areas))
        if track.errors[-1] < tolerance:
            return "sphere"
        if track.stalled():
            return "stalled"
    return "steps"


class _Track:
    """The shapes of a flow so far, with what decides when it ends."""

    def __init__(self, mesh: Mesh, patience: int | None) -> None:
        self.patience = patience
        self.shapes, self.moved = [mesh], [0.0]
        self.errors = [_sphere_error(mesh)]

    def add(self, shape: Mesh, displacement: float) -> None:
        """The next shape, and how far its vertices moved."""
        self.shapes.append(shape)
        self.moved.append(displacement)
        self.errors.append(_sphere_error(shape))

    def stalled(self) -> bool:
        if self.patience is None:
            return False
        since_best = len(self.errors) - 1 - int(np.argmin(self.errors))
        return since_best >= self.patience and self.moved[-1] < _STILL

    def flow(self, step: StepSchedule, reason: str) -> Flow:
        """The flow that is kept: up to its roundest shape where it stalled, else all of it."""
        kept = int(np.argmin(self.errors)) + 1 if reason == "stalled" else len(self.shapes)
        kept = max(kept, 2)
        steps = [step(k) for k in range(kept - 1)]
        return Flow(
            vertices=np.stack([shape.vertices for shape in self.shapes[:kept]]),
            faces=self.shapes[0].faces,
            times=np.concatenate([[0.0], np.cumsum(steps)]),
            arc_length=np.cumsum(self.moved[:kept]),
            sphere_error=np.array(self.errors[:kept]),
            converged=reason == "sphere",
            reason=reason,
        )


def _at_area(mesh: Mesh) -> Mesh:
    """The mesh as it flows."""
    # Comparisons with what is not a number are false.
    if not (np.isfinite(mesh.vertices).all() and mesh.area > 0):
        raise DegenerateMesh(
            f"{mesh.name}: positions are not finite, or the area is zero; a surface is required "
            "to flow; replace the mesh"
        )
    return normalize(mesh)


def _renormalized(mesh: Mesh, vertices: Float[np.ndarray, "n 3"]) -> Mesh:
    area = mesh.with_vertices(vertices).area
    if not np.isfinite(area) or area <= np.finfo(np.float64).tiny:
        raise DegenerateMesh(f"the step leaves an area of {area:g}")
    return normalize(mesh.with_vertices(vertices))


def _sphere_error(mesh: Mesh) -> float:
    return float(np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max())


def _displacement(before: np.ndarray, after: np.ndarray, mass: np.ndarray) -> float:
    return float(np.sqrt(mass @ np.sum((after - before) ** 2, axis=1) / mass.sum()))


def flow_score(flow: Flow, mesh: Mesh, *, weight: float = 1e-3, samples: int = 24) -> float:
    """Score s of a flow: how far from the sphere it ends and how much it deforms (paper Eq. 1).

    d²(S_0, S(1)) + η ∫_0^1 e_deform(S(t), S) dt, with t the fraction of arc length, the integral
    by the midpoint rule. e_deform is divided by the edge energy Σ_i Σ_j ‖p_i − p_j‖² of the
    input, so that η has the same meaning for every mesh.

    Parameters
    ----------
    mesh
        The input of the flow, with the flow's faces.
    weight
        η; at most 1e-3, as the integral rewards flows that do not move.
    """
    rest = ArapSystem(normalize(mesh), weights="uniform")
    middles = (np.arange(samples) + 0.5) / samples
    # One shape at a time: a flow of a large mesh need not be in memory twice.
    energies = [rest.energy(flow.at(np.array([t]))[0]) for t in middles]
    end = Mesh(flow.vertices[-1], flow.faces)
    return sphere_distance(end) ** 2 + weight * float(np.mean(energies)) / rest.edge_energy


def sphere_distance(mesh: Mesh) -> float:
    """Two-sided Hausdorff distance to the unit sphere, sampled at vertices of both surfaces."""
    ball = icosphere(_SPHERE_LEVEL).vertices
    squared = igl.point_mesh_squared_distance(ball, mesh.vertices, mesh.faces)[0]
    return max(_sphere_error(mesh), float(np.sqrt(np.max(squared))))


def accepted(scores: Float[np.ndarray, " k"], factor: float = 2.0) -> Bool[np.ndarray, " k"]:
    """The rule s < 2δ, δ the median of the scores (paper §4.1); infinite scores never pass."""
    finite = np.isfinite(scores)
    if not finite.any():
        return finite
    return finite & (scores < factor * np.median(scores[finite]))
