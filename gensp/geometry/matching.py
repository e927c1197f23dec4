"""Correspondences between two shapes through the sphere, and how far they can be relied on."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from gensp.geometry.distortion import isometric_distortion, singular_values
from gensp.geometry.harmonics import heat_kernel, sphere_grid
from gensp.geometry.points import SurfacePoints
from gensp.geometry.rotation_registration import (
    BANDLIMIT,
    SMOOTHING,
    density_signal,
    register_rotation,
)
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap

_CANDIDATES = 8  # rotations that are judged by the descriptors
_LEVEL = 3  # of the icosphere on whose vertices descriptors are compared
_SMALLEST = 1e-12  # norm of a signal: below, it is constant


@dataclass(frozen=True)
class Matching:
    """Where the vertices of one shape lie on another.

    Attributes
    ----------
    at
        Face and barycentric weights on the other shape, for every vertex.
    positions
        The same as points (n, 3).
    reliability
        In [0, 1], see `matching`.
    """

    at: SurfacePoints
    positions: Float[np.ndarray, "n 3"]
    reliability: Float[np.ndarray, " n"]


def matching(
    source: SphericalMap,
    target: SphericalMap,
    rotation: Float[np.ndarray, "3 3"] | None = None,
    *,
    weights: tuple[Float[np.ndarray, " n"] | None, Float[np.ndarray, " k"] | None] = (None, None),
) -> Matching:
    """Send every vertex of a shape through the sphere to another, m_b⁻¹(R m_a(x)).

    The reliability of a vertex is 1/σ of the map from shape to shape: σ its isometric distortion
    (paper §5.1), 1/σ at a vertex the area-weighted mean over its faces. Like parts of like shapes
    have nearly the same size, so a match that is right is nearly an isometry; a leg on a trunk is
    far from one. What both maps stretch alike does not count.

    Parameters
    ----------
    rotation
        R, from the source's sphere to the target's; none is the identity.
    weights
        Reliabilities in [0, 1] of the vertices of source and target that are already known; they
        are multiplied in.
    """
    image = source.sphere if rotation is None else source.sphere @ rotation.T
    at = target.locate(image)
    positions = at.on(target.surface, target.faces)
    reliability = nearness_to_isometry(source, positions)
    if weights[0] is not None:
        reliability = reliability * weights[0]
    if weights[1] is not None:
        reliability = reliability * at.on(weights[1][:, None], target.faces)[:, 0]
    return Matching(at, positions, np.clip(reliability, 0, 1))


def nearness_to_isometry(
    map: SphericalMap, positions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """1/σ at the vertices of a shape that is sent to `positions`, both at area 4π.

    The area-weighted mean over the faces at a vertex; a face that collapses counts as 0.
    """
    values = singular_values(map.surface, positions, map.faces)
    return at_vertices(map, 1 / isometric_distortion(values))


def at_vertices(map: SphericalMap, values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    """Area-weighted means at the vertices of values on the faces."""
    areas = map.mesh.face_areas
    corner, n = map.faces.reshape(-1), len(map.surface)
    total = np.bincount(corner, np.repeat(areas * values, 3), minlength=n)
    return total / np.bincount(corner, np.repeat(areas, 3), minlength=n)


def descriptors(map: SphericalMap, p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """What a shape looks like from the sphere, whatever its position, rotation and scale.

    The distance of m⁻¹(p) from the centroid, and the logarithm of the area that p stands for, each
    without its mean and divided by its deviation.
    """
    at, areas = map.locate(p), map.mesh.face_areas
    on_sphere = SphericalMap(map.sphere, map.sphere, map.faces).mesh.face_areas
    density = at_vertices(map, np.log(areas) - np.log(np.maximum(on_sphere, 1e-300)))
    values = np.stack([_radius(map, at), at.on(density[:, None], map.faces)[:, 0]], axis=1)
    return (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-12)


def _radius(map: SphericalMap, at: SurfacePoints) -> Float[np.ndarray, " k"]:
    """Distances of surface points from the area's centroid."""
    areas = map.mesh.face_areas
    centre = areas @ map.surface[map.faces].mean(axis=1) / areas.sum()
    return np.linalg.norm(at.on(map.surface, map.faces) - centre, axis=1)


def aligning_rotation(source: SphericalMap, target: SphericalMap) -> Float[np.ndarray, "3 3"]:
    """Rotation R of the sphere that makes two maps agree, from the shapes alone.

    It does not depend on the position, rotation or scale of either shape. Candidates are the
    largest maxima over SO(3) of the correlation of both shapes' signals (`shape_signal`); the one
    is taken under which their descriptors differ least, in the mean square.
    """
    p = icosphere(_LEVEL).vertices
    own = descriptors(source, p)
    found = register_rotation(shape_signal(source), shape_signal(target), candidates=_CANDIDATES)
    errors = [np.mean((descriptors(target, p @ one.rotation.T) - own) ** 2) for one in found]
    return found[int(np.argmin(errors))].rotation


def shape_signal(map: SphericalMap) -> Complex[np.ndarray, "l o"]:
    """Harmonic coefficients of the root of the area's density plus i times the distance from c.

    Both parts have norm one, so that the real part of the correlation of two signals is the sum of
    the correlations of densities and of distances from the centroid c; it also tells apart
    shapes whose map preserves area.
    """
    density = density_signal(map.sphere, map.faces, map.mesh.face_areas)
    grid = sphere_grid(2 * BANDLIMIT)
    radius = _radius(map, map.locate(grid.points.reshape(-1, 3))).reshape(grid.points.shape[:2])
    distance = grid.coefficients(radius, BANDLIMIT) * heat_kernel(BANDLIMIT, SMOOTHING)[:, None]
    distance[0] = 0  # as in the density: the mean is the same in every rotation
    return _normed(density) + 1j * _normed(distance)


def _normed(signal: Complex[np.ndarray, "l o"]) -> Complex[np.ndarray, "l o"]:
    return signal / max(float(np.linalg.norm(signal)), _SMALLEST)
