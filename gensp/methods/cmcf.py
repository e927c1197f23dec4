"""The classical baseline: conformalised mean curvature flow to the sphere."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import centre_of_area, moebius_center
from gensp.geometry.certificate import certify
from gensp.geometry.flow import Flow, StepSchedule, cmcf
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.predicates import bad_faces, spherical_orientation
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_map import SphericalMap

# Length of the centre of area from which on a map counts as not centred.
_OFF_CENTRE = 1e-8

Refinement = Callable[[Mesh, np.ndarray, np.ndarray | None], SphericalMap]


@dataclass(frozen=True)
class CMCF:
    """Spherical parameterization by the flow's end, centred by Möbius transformations.

    The start is centred, and so is the refined map, where its certificate stays clean.

    Attributes
    ----------
    refine
        Called with the mesh, the start (n, 3) and no target; gives the final map.
    step, max_steps, tolerance, intrinsic, full, patience
        Of the flow (Kazhdan, Solomon & Ben-Chen 2012).
    """

    refine: Refinement
    step: StepSchedule = field(default_factory=StepSchedule)
    max_steps: int = 100
    tolerance: float = 0.015
    intrinsic: bool = True
    full: bool = False
    patience: int | None = 10
    name: str = "cmcf"

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh; the diagnostics tell how its flow ended, and if it is centred."""
        began = time.perf_counter()
        shape = normalize(mesh)
        flow = self._flow(shape)
        start = _centred(_outward(unit(flow.vertices[-1]), shape), shape)
        refined = self.refine(mesh, start, None)
        sphere = _certified_centre(refined.sphere, shape)
        off = centre_of_area(sphere, shape.faces, shape.face_areas)
        found = {
            "flow": flow.reason,
            "flow_steps": len(flow.times) - 1,
            "centred": bool(np.linalg.norm(off) <= _OFF_CENTRE),
            "seconds": time.perf_counter() - began,
        }
        return replace(refined, sphere=sphere, diagnostics={**refined.diagnostics, **found})

    def _flow(self, mesh: Mesh) -> Flow:
        return cmcf(
            mesh,
            step=self.step,
            max_steps=self.max_steps,
            tolerance=self.tolerance,
            intrinsic=self.intrinsic,
            full=self.full,
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


def _certified_centre(u: Float[np.ndarray, "n 3"], mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """The Möbius-centred map if both it and the map as it is are certified, else the latter."""
    centred = _centred(u, mesh)
    both = certify(u, mesh.faces).bijective and certify(centred, mesh.faces).bijective
    return centred if both else u
