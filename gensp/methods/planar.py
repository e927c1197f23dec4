"""Spherical parameterization by way of the plane (after Chen et al. 2025)."""

import time
from dataclasses import dataclass, replace

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.planar_reduction import (
    inverse_stereographic,
    planar_map,
    removable_face,
)
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.refinement import NoRefinement


@dataclass(frozen=True)
class PlanarReduction:
    """One triangle removed, the rest optimised in the plane, put back on the sphere.

    Folds that arise because planar edges become circular arcs, while a spherical map has great
    circles, are counted, not repaired.

    Attributes
    ----------
    max_iterations, tolerance
        Of Newton's method (`gensp.geometry.planar_reduction.planar_map`).
    attempts
        So many of the most regular triangles are tried until the embedding inside one is not
        beyond double precision.
    """

    max_iterations: int = 300
    tolerance: float = 1e-4
    attempts: int = 30
    name: str = "vc25"

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh.

        Raises
        ------
        NotEmbeddable
            The planar embedding to start from is beyond double precision, whichever triangle is
            removed.
        """
        began = time.perf_counter()
        shape = normalize(mesh)
        outer = removable_face(shape, self.attempts)
        found = planar_map(
            shape, outer, max_iterations=self.max_iterations, tolerance=self.tolerance
        )
        map = NoRefinement()(mesh, inverse_stereographic(found.plane))
        numbers = {
            "removed_face": outer,
            "iterations": found.iterations,
            "converged": found.converged,
            "energy": found.energy,
            "seconds": time.perf_counter() - began,
        }
        return replace(map, diagnostics={**map.diagnostics, **numbers})
