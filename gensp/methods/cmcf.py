"""The classical baseline: conformalised mean curvature flow to the sphere."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import moebius_center
from gensp.geometry.flow import Flow, StepSchedule, cmcf
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.predicates import bad_faces, spherical_orientation
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_map import SphericalMap

Refinement = Callable[[Mesh, np.ndarray, np.ndarray | None], SphericalMap]


@dataclass(frozen=True)
class CMCF:
    """Spherical parameterization by the flow's end, centred by a Möbius transformation.

    Attributes
    ----------
    refine
        Called with the mesh, the start (n, 3) and no target; gives the final map.
    step, max_steps, tolerance, intrinsic, patience
        Of the flow (Kazhdan, Solomon & Ben-Chen 2012).
    """

    refine: Refinement
    step: StepSchedule = field(default_factory=StepSchedule)
    max_steps: int = 100
    tolerance: float = 0.015
    intrinsic: bool = True
    patience: int | None = 10
    name: str = "cmcf"

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh; the diagnostics tell how its flow ended."""
        began = time.perf_counter()
        shape = normalize(mesh)
        flow = self._flow(shape)
        start = _centred(_outward(unit(flow.vertices[-1]), shape), shape)
        refined = self.refine(mesh, start, None)
        found = {
            "flow": flow.reason,
            "flow_steps": len(flow.times) - 1,
            "seconds": time.perf_counter() - began,
        }
        return replace(refined, diagnostics={**refined.diagnostics, **found})

    def _flow(self, mesh: Mesh) -> Flow:
        return cmcf(
            mesh,
            step=self.step,
            max_steps=self.max_steps,
            tolerance=self.tolerance,
            intrinsic=self.intrinsic,
            patience=self.patience,
        )


def _outward(u: Float[np.ndarray, "n 3"], mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """The map or its antipode, whichever has more faces that look outwards."""
    return u if spherical_orientation(u, mesh.faces).sum() >= 0 else -u


def _centred(u: Float[np.ndarray, "n 3"], mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """The Möbius-centred map, unless rounding would fold crowded faces that are sound now."""
    try:
        centred = moebius_center(u, mesh.faces, mesh.face_areas)
    except NotEmbeddable:
        return u
    before, after = (bad_faces(x, mesh.faces).sum() for x in (u, centred))
    return centred if after <= before else u
