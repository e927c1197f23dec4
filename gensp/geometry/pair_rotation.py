"""The rotation of the sphere after which two maps agree best (paper §5.1)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from gensp.geometry.implied import MatchedMaps
from gensp.geometry.points import SurfacePoints
from gensp.geometry.spherical_map import SphericalMap

_FEW = 200  # points by which rotations are compared
_TRIALS = 80  # rotations that are tried around the best start
_WIDE = 0.15  # radians between the first of them
_FINE = 1e-3  # radians, and relative error, at which the search ends


def pair_rotation(
    matched: MatchedMaps, starts: Sequence[Float[np.ndarray, "3 3"]] = ()
) -> Float[np.ndarray, "3 3"]:
    """The rotation R of the least mean implied-correspondence error that a local search finds.

    The search (Nelder & Mead 1965, over rotation vectors) begins at the best of the identity and
    `starts`, and compares rotations at 200 of the points.
    """
    few = matched.few(_FEW)
    there = _OneWay(few.map_i, few.map_j, few.at_i, few.at_j)
    back = _OneWay(few.map_j, few.map_i, few.at_j, few.at_i)

    def error(rotation: Float[np.ndarray, "3 3"]) -> float:
        return there.error(rotation) + back.error(rotation.T)

    start = min([np.eye(3), *starts], key=error)

    def turned(vector: np.ndarray) -> Float[np.ndarray, "3 3"]:
        return Rotation.from_rotvec(vector).as_matrix() @ start

    options = {
        "initial_simplex": _WIDE * np.concatenate([np.zeros((1, 3)), np.eye(3)]),
        "maxfev": _TRIALS,
        "xatol": _FINE,
        "fatol": _FINE * error(start),
    }
    found = minimize(
        lambda vector: error(turned(vector)), np.zeros(3), method="Nelder-Mead", options=options
    )
    return turned(found.x)


class _OneWay:
    """Implied-correspondence errors from S_i to S_j, with what all rotations share."""

    def __init__(
        self, map_i: SphericalMap, map_j: SphericalMap, at_i: SurfacePoints, at_j: SurfacePoints
    ) -> None:
        self.images, self.map = map_i.to_sphere(at_i), map_j
        self.true = at_j.on(map_j.surface, map_j.faces)
        self.scale = np.sqrt(map_j.mesh.area)
        self.faces: Int[np.ndarray, " k"] | None = None

    def error(self, rotation: Float[np.ndarray, "3 3"]) -> float:
        """Mean over the points."""
        at = self.map.locate(self.images @ rotation.T, self.faces)
        self.faces = at.faces  # the next rotation is a near one
        implied = at.on(self.map.surface, self.map.faces)
        return float(np.linalg.norm(implied - self.true, axis=1).mean() / self.scale)
