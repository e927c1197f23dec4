"""As-rigid-as-possible spherical parametrization (Wang, Liu & Liu 2014)."""

import time
from dataclasses import dataclass, replace

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.spherical_arap import rigid_map
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods import SphericalParameterization
from gensp.methods.refinement import NoRefinement


@dataclass(frozen=True)
class ARAP:
    """Local/global iteration from another method's map; its folds are counted, not repaired.

    Attributes
    ----------
    start
        The method that gives the start: the flow, next to which the iteration may stay, or one of
        little distortion.
    attraction, max_iterations, tolerance
        Of the iteration (`gensp.geometry.spherical_arap.rigid_map`).
    """

    start: SphericalParameterization
    attraction: float = 10.0
    max_iterations: int = 200
    tolerance: float = 1e-5
    name: str = "arap"

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh; the diagnostics count the folds of the start and of the end."""
        began = time.perf_counter()
        start = self.start(mesh)
        found = rigid_map(
            normalize(mesh),
            start.sphere,
            attraction=self.attraction,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
        )
        map = NoRefinement()(mesh, found.sphere)
        numbers = {
            "bad_faces_start": int(start.bad_faces().sum()),
            "iterations": found.iterations,
            "converged": found.converged,
            "rigidity": found.energy,
            "seconds_start": start.diagnostics["seconds"],
            "seconds": time.perf_counter() - began,
        }
        return replace(map, diagnostics={**map.diagnostics, **numbers})
