"""How well shapes and their maps agree: the weights of c, generated surfaces, distances of shapes.

The errors that the weights of c average are those of `gensp.geometry.implied` (paper §5.1).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import lumped_mass
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import sample_sphere
from gensp.geometry.spherical_map import SphericalMap

_FIRST_BATCH = 64


@dataclass(frozen=True)
class GeneratedShape:
    """A shape S_i and the image of the icosphere that a generator made for it, g_i.

    Both at the same scale; images that are compared have the same triangles.
    """

    mesh: Mesh
    image: Mesh

    @cached_property
    def on_mesh(self) -> ClosestPointTree:
        """Closest points of the shape."""
        return ClosestPointTree(self.mesh)

    @cached_property
    def on_image(self) -> ClosestPointTree:
        """Closest points of the generated surface."""
        return ClosestPointTree(self.image)


def prediction_error(
    shape_i: GeneratedShape, shape_j: GeneratedShape, at_i: SurfacePoints, at_j: SurfacePoints
) -> Float[np.ndarray, " k"]:
    """Implied-correspondence error of two generated surfaces, before any map is made of them.

    ‖π_j(g_j(p_k)) − m_ij(x_k)‖ / √area(S_j): g_i(p_k) is the point of the generated surface
    closest to x_k, π_j the closest point on S_j. Unlike a map read off the surfaces it is defined
    where these fold.

    Parameters
    ----------
    at_i, at_j
        The same k ground-truth points x_k on S_i and m_ij(x_k) on S_j.
    """
    x = at_i.on(shape_i.mesh.vertices, shape_i.mesh.faces)
    p = shape_i.on_image.query(x).at
    carried = p.on(shape_j.image.vertices, shape_j.image.faces)
    implied = shape_j.on_mesh.query(carried).points
    true = at_j.on(shape_j.mesh.vertices, shape_j.mesh.faces)
    return np.linalg.norm(implied - true, axis=1) / np.sqrt(shape_j.mesh.area)


def generated_consistency(
    shape_i: GeneratedShape,
    shape_j: GeneratedShape,
    at_i: SurfacePoints,
    at_j: SurfacePoints,
    hausdorff: float,
) -> float:
    """C of two generated surfaces: the mean of both directions, over the Hausdorff distance.

    The images of the icosphere's vertices are the uniform samples of the sphere, and
    `prediction_error` stands for the maps that are not made yet.

    Parameters
    ----------
    at_i, at_j
        The same k ground-truth points x_k on S_i and m_ij(x_k) on S_j.
    hausdorff
        Distance of the two shapes.
    """
    ways = ((shape_i, shape_j, at_i, at_j), (shape_j, shape_i, at_j, at_i))
    return float(np.mean([_one_way(*way) for way in ways]) / hausdorff)


def _one_way(
    shape_i: GeneratedShape, shape_j: GeneratedShape, at_i: SurfacePoints, at_j: SurfacePoints
) -> float:
    x = at_i.on(shape_i.mesh.vertices, shape_i.mesh.faces)
    weights = _share_of_nearest(shape_i.image.vertices, x)
    error = prediction_error(shape_i, shape_j, at_i, at_j)
    return float(error @ weights * np.sqrt(shape_j.mesh.area))


def sphere_uniform_weights(
    map: SphericalMap, at: SurfacePoints, count: int, generator: np.random.Generator
) -> Float[np.ndarray, " k"]:
    """Weights of surface points that stand for uniform samples of the sphere, summing to one.

    Every sample is taken to the surface by m⁻¹ and counted for the nearest of the points: the
    paper's choice of sample points. It flatters maps that starve limbs.
    """
    samples = map.to_surface(sample_sphere(count, generator))
    return _share_of_nearest(samples, at.on(map.surface, map.faces))


def area_uniform_weights(
    map: SphericalMap, at: SurfacePoints, count: int, generator: np.random.Generator
) -> Float[np.ndarray, " k"]:
    """Weights of surface points that stand for area-uniform samples of the surface."""
    samples = sample_surface(map.mesh.face_areas, count, generator).on(map.surface, map.faces)
    return _share_of_nearest(samples, at.on(map.surface, map.faces))


def _share_of_nearest(
    samples: Float[np.ndarray, "s 3"], points: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    nearest = cKDTree(points).query(samples)[1]
    return np.bincount(nearest, minlength=len(points)) / len(samples)


@dataclass(frozen=True)
class Coverage:
    """Distances from a shape to a surface that should cover it, over √area of the shape."""

    mean: float
    max: float


def coverage(mesh: Mesh, surface: Mesh) -> Coverage:
    """How much of a shape a surface leaves out: area-weighted mean, and max, over its vertices."""
    distance = ClosestPointTree(surface).query(mesh.vertices).distance / np.sqrt(mesh.area)
    weights = lumped_mass(mesh.vertices, mesh.faces)
    return Coverage(float(np.average(distance, weights=weights)), float(distance.max()))


class HausdorffIndex:
    """One shape prepared for Hausdorff distances to many others."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    @cached_property
    def _surface(self) -> ClosestPointTree:
        return ClosestPointTree(self.mesh)

    @cached_property
    def _vertices(self) -> cKDTree:
        return cKDTree(self.mesh.vertices)

    def distance(self, other: "HausdorffIndex") -> float:
        """Two-sided Hausdorff distance, vertices to surface."""
        return max(self._farthest(other.mesh.vertices), other._farthest(self.mesh.vertices))

    def _farthest(self, points: Float[np.ndarray, "k 3"]) -> float:
        # The nearest vertex bounds the distance to the surface from above: only the points whose
        # bound exceeds the best distance found can be the farthest.
        bound = self._vertices.query(points)[0]
        order = np.argsort(-bound)
        first, rest = order[:_FIRST_BATCH], order[_FIRST_BATCH:]
        best = float(self._surface.query(points[first]).distance.max())
        rest = rest[bound[rest] > best]
        if len(rest):
            best = max(best, float(self._surface.query(points[rest]).distance.max()))
        return best


def nearest_neighbours(distances: Float[np.ndarray, "n n"], count: int) -> Bool[np.ndarray, "n n"]:
    """Edges of the graph that joins every shape to its `count` nearest others (paper §5.1)."""
    joined = np.zeros(distances.shape, dtype=bool)
    apart = distances + np.diag(np.full(len(distances), np.inf))
    count = min(count, len(distances) - 1)
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :count]
    np.put_along_axis(joined, nearest, True, axis=1)
    return joined | joined.T
