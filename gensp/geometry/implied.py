"""Implied correspondences: where two spherical maps say that a point lies (paper §5.1).

All measures of consistency follow from one vector: the distance on S_j between m_j⁻¹(R m_i(x)),
where the maps say that a point x of S_i lies, and m_ij(x), where the ground truth has it.
R is the identity or another rotation of the sphere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from gensp.geometry.alignment import best_rotation
from gensp.geometry.geodesics import geodesic_distances
from gensp.geometry.points import SurfacePoints
from gensp.geometry.spherical_map import SphericalMap


def correspondence_error(
    map_i: SphericalMap,
    map_j: SphericalMap,
    at_i: SurfacePoints,
    at_j: SurfacePoints,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> Float[np.ndarray, " k"]:
    """Implied-correspondence error ‖m_j⁻¹(R m_i(x_k)) − m_ij(x_k)‖ / √area(S_j).

    Parameters
    ----------
    at_i, at_j
        The same k ground-truth points x_k on S_i and m_ij(x_k) on S_j.
    rotation
        R; none is the identity.
    """
    implied = _implied(map_i, map_j, at_i, rotation)
    true = at_j.on(map_j.surface, map_j.faces)
    return np.linalg.norm(implied - true, axis=1) / np.sqrt(map_j.mesh.area)


def frame_error(
    map_i: SphericalMap,
    map_j: SphericalMap,
    at_i: SurfacePoints,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> Float[np.ndarray, " k"]:
    """The same where no ground truth is, x_k itself for m_ij(x_k): both shapes in one frame.

    ‖m_j⁻¹(R m_i(x_k)) − x_k‖ / √area(S_j). Zero only where the shapes coincide.

    Parameters
    ----------
    at_i
        k points x_k on S_i.
    rotation
        R; none is the identity.
    """
    implied = _implied(map_i, map_j, at_i, rotation)
    x = at_i.on(map_i.surface, map_i.faces)
    return np.linalg.norm(implied - x, axis=1) / np.sqrt(map_j.mesh.area)


def geodesic_error(
    map_i: SphericalMap,
    map_j: SphericalMap,
    at_i: SurfacePoints,
    at_j: SurfacePoints,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> Float[np.ndarray, " k"]:
    """The same along the surface: geodesic distance on S_j / √area(S_j).

    As in the curves of Kim, Lipman & Funkhouser (2011), the "Princeton protocol".
    """
    implied = map_j.locate(_image(map_i, at_i, rotation))
    return geodesic_distances(map_j.mesh, at_j, implied) / np.sqrt(map_j.mesh.area)


def symmetric_error(
    map_i: SphericalMap,
    map_j: SphericalMap,
    at_i: SurfacePoints,
    at_j: SurfacePoints,
    groups: Sequence[Sequence[int]],
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> Float[np.ndarray, " k"]:
    """The same where symmetries of S_j exchange points: every group in its best order.

    Of all ways to pair the implied points of a group with its true ones, one to one, that of the
    least total error counts.

    Parameters
    ----------
    groups
        Places among the k points, no place in two groups.
    """
    implied = _implied(map_i, map_j, at_i, rotation)
    true = at_j.on(map_j.surface, map_j.faces).copy()
    for group in map(list, groups):
        cost = np.linalg.norm(implied[group][:, None] - true[group][None], axis=2)
        true[group] = true[group][linear_sum_assignment(cost)[1]]
    return np.linalg.norm(implied - true, axis=1) / np.sqrt(map_j.mesh.area)


def _implied(
    map_i: SphericalMap,
    map_j: SphericalMap,
    at_i: SurfacePoints,
    rotation: Float[np.ndarray, "3 3"] | None,
) -> Float[np.ndarray, "k 3"]:
    """Where the maps say that points of S_i lie on S_j."""
    return map_j.to_surface(_image(map_i, at_i, rotation))


def _image(
    map_i: SphericalMap, at_i: SurfacePoints, rotation: Float[np.ndarray, "3 3"] | None
) -> Float[np.ndarray, "k 3"]:
    image = map_i.to_sphere(at_i)
    return image if rotation is None else image @ rotation.T


@dataclass(frozen=True)
class MatchedMaps:
    """Two maps m_i, m_j and the same k ground-truth points x_k on S_i and m_ij(x_k) on S_j."""

    map_i: SphericalMap
    map_j: SphericalMap
    at_i: SurfacePoints
    at_j: SurfacePoints

    def errors(
        self, rotation: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Implied-correspondence errors from S_i to S_j after R, and back after Rᵀ."""
        return (
            correspondence_error(self.map_i, self.map_j, self.at_i, self.at_j, rotation),
            correspondence_error(self.map_j, self.map_i, self.at_j, self.at_i, rotation.T),
        )

    def error(self, rotation: Float[np.ndarray, "3 3"]) -> float:
        """Their mean over points and directions."""
        return float(np.mean(self.errors(rotation)))

    def geodesic_errors(
        self, rotation: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """The same two along the surfaces."""
        return (
            geodesic_error(self.map_i, self.map_j, self.at_i, self.at_j, rotation),
            geodesic_error(self.map_j, self.map_i, self.at_j, self.at_i, rotation.T),
        )

    def least_squares(self) -> Float[np.ndarray, "3 3"]:
        """R of the least Σ ‖R m_i(x_k) − m_j(m_ij(x_k))‖² on the sphere."""
        return best_rotation(self.map_i.to_sphere(self.at_i), self.map_j.to_sphere(self.at_j))

    def few(self, count: int) -> "MatchedMaps":
        """The same at about so many of the points, evenly taken."""
        return self._at(np.unique(np.linspace(0, len(self.at_i) - 1, count).astype(int)))

    def drawn(self, count: int, seed: int) -> "MatchedMaps":
        """The same at so many of the points, or at all of fewer, drawn at random."""
        known = len(self.at_i)
        random = np.random.default_rng(seed)
        return self._at(np.sort(random.choice(known, min(count, known), replace=False)))

    def _at(self, chosen: Int[np.ndarray, " k"]) -> "MatchedMaps":
        return MatchedMaps(self.map_i, self.map_j, self.at_i.take(chosen), self.at_j.take(chosen))
