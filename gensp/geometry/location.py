"""Finding points of the unit sphere in a spherical triangulation."""

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

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
        self._across = igl.triangle_triangle_adjacency(self.faces)[0]

    def locate(self, p: Float[np.ndarray, "k 3"]) -> SurfacePoints:
        """Face and radial barycentric weights of every direction p (need not be unit)."""
        p = np.ascontiguousarray(p)
        nearest = self._tree.squared_distance(self.sphere, self.faces, p)[1]
        face = np.asarray(nearest, dtype=np.int64).reshape(-1)
        best, best_weights = face.copy(), self._weights(p, face)
        active = np.arange(len(p))
        for _ in range(_MAX_STEPS):
            active = active[best_weights[active].min(axis=1) < 0]
            if len(active) == 0:
                break
            face[active] = self._step(p[active], face[active])
            weights = self._weights(p[active], face[active])
            better = weights.min(axis=1) > best_weights[active].min(axis=1)
            best[active[better]] = face[active[better]]
            best_weights[active[better]] = weights[better]
        weights = np.clip(best_weights, 0, None)
        return SurfacePoints(best, weights / weights.sum(axis=1, keepdims=True))

    def _step(
        self, p: Float[np.ndarray, "k 3"], face: Int[np.ndarray, " k"]
    ) -> Int[np.ndarray, " k"]:
        weakest = self._weights(p, face).argmin(axis=1)
        # Weight j belongs to corner j; the edge opposite to it is number j+1 in libigl's order.
        return self._across[face, (weakest + 1) % 3].astype(np.int64)

    def _weights(
        self, p: Float[np.ndarray, "k 3"], face: Int[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k 3"]:
        """Weights w with Σ w_j u_j parallel to p, summing to one in absolute value."""
        a, b, c = (self.sphere[self.faces[face, k]] for k in range(3))
        raw = np.stack([_triple(p, b, c), _triple(a, p, c), _triple(a, b, p)], axis=1)
        total = np.abs(raw).sum(axis=1, keepdims=True)
        return raw / np.where(total > 0, total, 1)


def _triple(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Float[np.ndarray, " k"]:
    return np.einsum("ij,ij->i", a, np.cross(b, c))


def contains(weights: Float[np.ndarray, "k 3"], slack: float = 1e-9) -> Bool[np.ndarray, " k"]:
    """Which located points lie inside their triangle up to `slack`."""
    return weights.min(axis=1) >= -slack
