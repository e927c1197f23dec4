"""Correspondences between two shapes through the sphere, and how far they can be relied on."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gensp.geometry.distortion import isometric_distortion, singular_values
from gensp.geometry.points import SurfacePoints
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap

_STARTS, _REFINED = 4608, 8
_COARSE, _FINE = 2, 4  # icosphere levels at which descriptors are compared


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

    The reliability of a vertex is 1/(σ_a σ_b): σ_a is the isometric distortion (paper §5.1) of the
    source's map at the vertex, the area-weighted mean of its faces', σ_b that of the target's map
    at the image. It is 1 where both maps are isometries, and falls where one of them stretches or
    shrinks, for there a small shift on the sphere is a large one on a shape.

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
    there = vertex_reliability(target) * _or_one(weights[1])
    reached = at.on(there[:, None], target.faces)[:, 0]
    reliability = vertex_reliability(source) * _or_one(weights[0]) * reached
    return Matching(at, at.on(target.surface, target.faces), np.clip(reliability, 0, 1))


def _or_one(values: Float[np.ndarray, " n"] | None) -> Float[np.ndarray, " n"] | float:
    return 1.0 if values is None else values


def vertex_reliability(map: SphericalMap) -> Float[np.ndarray, " n"]:
    """1/σ at the vertices: the area-weighted mean over their faces of the distortion's inverse."""
    sigma = isometric_distortion(singular_values(map.surface, map.sphere, map.faces))
    return at_vertices(map, 1 / sigma)


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
    at = map.locate(p)
    areas = map.mesh.face_areas
    on_sphere = SphericalMap(map.sphere, map.sphere, map.faces).mesh.face_areas
    centre = areas @ map.surface[map.faces].mean(axis=1) / areas.sum()
    radius = np.linalg.norm(at.on(map.surface, map.faces) - centre, axis=1)
    density = at_vertices(map, np.log(areas) - np.log(np.maximum(on_sphere, 1e-300)))
    values = np.stack([radius, at.on(density[:, None], map.faces)[:, 0]], axis=1)
    return (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-12)


def aligning_rotation(source: SphericalMap, target: SphericalMap) -> Float[np.ndarray, "3 3"]:
    """Rotation R of the sphere that makes two maps agree, from the shapes alone.

    The descriptors of both shapes are compared under rotations that cover SO(3) evenly (Alexa
    2022, "Super-Fibonacci spirals"); the best are refined (Nelder & Mead 1965). It does not
    depend on the position, rotation or scale of either shape.
    `rotation_registration.register_rotation` compares the density of area alone, by one FFT; here
    the distance from the centroid is compared too, at the price of seconds.
    """
    coarse, starts = icosphere(_COARSE).vertices, _rotations(_STARTS)
    own = descriptors(source, coarse)
    other = _Sampled.of(target)
    errors = np.array([other.error(own, coarse @ turn.T) for turn in starts])
    fine = icosphere(_FINE - 1).vertices
    own = descriptors(source, fine)
    best, least = np.eye(3), np.inf
    for start in starts[np.argsort(errors)[:_REFINED]]:
        found = minimize(
            lambda v, start=start: other.error(own, fine @ (_turn(v) @ start).T),
            np.zeros(3),
            method="Nelder-Mead",
            options={"initial_simplex": 0.15 * np.eye(4, 3, k=-1), "xatol": 1e-3, "fatol": 1e-6},
        )
        if found.fun < least:
            best, least = _turn(found.x) @ start, float(found.fun)
    return best


def _turn(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    matrix: np.ndarray = Rotation.from_rotvec(vector).as_matrix()
    return matrix


@dataclass(frozen=True)
class _Sampled:
    """Descriptors of a shape on an icosphere, looked up by the three nearest vertices."""

    tree: cKDTree
    values: Float[np.ndarray, "k 2"]

    @classmethod
    def of(cls, map: SphericalMap) -> "_Sampled":
        p = icosphere(_FINE).vertices
        return cls(cKDTree(p), descriptors(map, p))

    def error(self, own: Float[np.ndarray, "k 2"], p: Float[np.ndarray, "k 3"]) -> float:
        """Mean squared difference of descriptors at points p of this shape's sphere."""
        far, near = self.tree.query(p, k=3)
        weights = 1 / np.maximum(far, 1e-9)
        weights /= weights.sum(axis=1, keepdims=True)
        there = np.einsum("kj,kjc->kc", weights, self.values[near])
        return float(np.mean((there - own) ** 2))


def _rotations(count: int) -> Float[np.ndarray, "count 3 3"]:
    """Evenly spread rotations, by the super-Fibonacci spiral."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    small, large = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    parts = (small * np.sin(alpha), small * np.cos(alpha), large * np.sin(beta))
    quaternions = np.stack([*parts, large * np.cos(beta)], axis=1)
    matrices: np.ndarray = Rotation.from_quat(quaternions).as_matrix()
    return matrices
