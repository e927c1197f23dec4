"""Finding points of the unit sphere in a spherical triangulation."""

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.compiled.walk import walk
from gensp.geometry.points import SurfacePoints

_MAX_STEPS = 400


class SphereLocator:
    """Radial point location: which spherical triangle a direction passes through.

    The nearest chordal triangle is the first guess, from which a walk crosses the edge whose
    great circle separates the point most. In a map without folds the walk ends in the one
    triangle that contains the point; where faces are folded it ends in the best one met.
    """

    def __init__(self, sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> None:
        self.sphere = np.ascontiguousarray(sphere)
        self.faces = np.ascontiguousarray(faces)
        self._tree = igl.AABB()
        self._tree.init(self.sphere, self.faces)
        # Edge k of libigl joins corners k and k + 1.
        self._across = np.asarray(igl.triangle_triangle_adjacency(self.faces)[0], dtype=np.int64)

    def locate(
        self, p: Float[np.ndarray, "k 3"], near: Int[np.ndarray, " k"] | None = None
    ) -> SurfacePoints:
        """Face and radial barycentric weights of every direction p (need not be unit).

        Parameters
        ----------
        near
            Faces that the walks begin at; without, those of the nearest chordal triangles.
        """
        p = np.ascontiguousarray(p)
        start = self._nearest(p) if near is None else np.ascontiguousarray(near)
        face, weights = walk(p, start, self.sphere, self.faces, self._across, _MAX_STEPS)
        weights = np.clip(weights, 0, None)
        return SurfacePoints(face, weights / weights.sum(axis=1, keepdims=True))

    def _nearest(self, p: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
        nearest = self._tree.squared_distance(self.sphere, self.faces, p)[1]
        return np.asarray(nearest, dtype=np.int64).reshape(-1)


def contains(weights: Float[np.ndarray, "k 3"], slack: float = 1e-9) -> Bool[np.ndarray, " k"]:
    """Which located points lie inside their triangle up to `slack`."""
    return weights.min(axis=1) >= -slack
