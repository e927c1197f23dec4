"""Closest points, signed distance and Hausdorff distance against a triangulated surface."""

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from jaxtyping import Float, Int

from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints

_GRID_BITS = 10


@dataclass(frozen=True)
class ClosestPoints:
    """Closest points (k, 3) of a surface, their place in it, and their squared distances."""

    points: Float[np.ndarray, "k 3"]
    at: SurfacePoints
    squared_distance: Float[np.ndarray, " k"]

    @property
    def distance(self) -> Float[np.ndarray, " k"]:
        """Unsigned distances."""
        return np.sqrt(self.squared_distance)


class ClosestPointTree:
    """Bounding-volume hierarchy of one surface, built once for any number of queries."""

    def __init__(self, mesh: Mesh) -> None:
        self.vertices = np.ascontiguousarray(mesh.vertices)
        self.faces = np.ascontiguousarray(mesh.faces)
        self._boxes = igl.AABB()
        self._boxes.init(self.vertices, self.faces)

    @cached_property
    def _winding(self) -> igl.FastWindingNumberBVH:
        winding = igl.FastWindingNumberBVH()
        winding.init(self.vertices, self.faces, 2)
        return winding

    def query(self, points: Float[np.ndarray, "k 3"]) -> ClosestPoints:
        """Closest point of the surface for every query point."""
        # Neighbouring queries walk the same boxes: sorted they are answered three times faster.
        order = morton_order(points)
        squared, face, closest = self._boxes.squared_distance(
            self.vertices, self.faces, np.ascontiguousarray(points[order])
        )
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        # libigl returns C "long long", a type of its own to numpy.
        face = np.asarray(face, dtype=np.int64).reshape(-1)[back]
        closest = closest.reshape(-1, 3)[back]
        weights = barycentric_coordinates(closest, self.vertices[self.faces[face]])
        return ClosestPoints(closest, SurfacePoints(face, weights), squared.reshape(-1)[back])

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Distance to the surface, negative inside.

        The sign is that of the fast winding number; libigl's own signed distance of that type
        scales the distance by the approximate winding number and is off by it.
        """
        inside = self._winding.winding_number(np.ascontiguousarray(points)).reshape(-1) > 0.5
        distance = self.query(points).distance
        return np.where(inside, -distance, distance)


def closest_point(points: Float[np.ndarray, "k 3"], mesh: Mesh) -> ClosestPoints:
    """Closest point of a surface for every query point."""
    return ClosestPointTree(mesh).query(points)


def signed_distance(points: Float[np.ndarray, "k 3"], mesh: Mesh) -> Float[np.ndarray, " k"]:
    """Distance of points to a closed surface, negative inside."""
    return ClosestPointTree(mesh).signed_distance(points)


def hausdorff(a: Mesh, b: Mesh) -> float:
    """Two-sided Hausdorff distance, from the vertices of each mesh to the surface of the other."""
    there = closest_point(a.vertices, b).squared_distance.max()
    back = closest_point(b.vertices, a).squared_distance.max()
    return float(np.sqrt(max(there, back)))


def barycentric_coordinates(
    points: Float[np.ndarray, "k 3"], triangles: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k 3"]:
    """Weights of points that lie on their triangles: non-negative, summing to one.

    On a triangle without area the point is placed on the longest side.
    """
    a, b, c = (triangles[:, j] for j in range(3))
    normal = np.cross(b - a, c - a)
    parts = [np.cross(c - b, points - b), np.cross(a - c, points - c), np.cross(b - a, points - a)]
    weights = np.stack([np.einsum("kj,kj->k", part, normal) for part in parts], axis=1)
    squared = np.einsum("kj,kj->k", normal, normal)
    sides = np.linalg.norm(triangles[:, [2, 0, 1]] - triangles[:, [1, 2, 0]], axis=2)
    flat = squared <= (1e-14 * sides.max(axis=1) ** 2) ** 2
    weights[flat] = _weights_on_side(points[flat], triangles[flat], sides[flat].argmax(axis=1))
    weights = np.clip(weights, 0, None)
    return weights / weights.sum(axis=1, keepdims=True)


def _weights_on_side(
    points: Float[np.ndarray, "k 3"],
    triangles: Float[np.ndarray, "k 3 3"],
    opposite: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "k 3"]:
    row = np.arange(len(points))
    start, end = (opposite + 1) % 3, (opposite + 2) % 3
    side = triangles[row, end] - triangles[row, start]
    length = np.einsum("kj,kj->k", side, side)
    along = np.einsum("kj,kj->k", points - triangles[row, start], side)
    t = np.clip(along / np.where(length > 0, length, 1), 0, 1)
    weights = np.zeros((len(points), 3))
    weights[row, start], weights[row, end] = 1 - t, t
    return weights


def morton_order(points: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
    """Order along a Z-shaped space-filling curve on a 1024³ grid."""
    if len(points) == 0:
        return np.arange(0)
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = (points - low) / (extent if extent > 0 else 1) * (2**_GRID_BITS - 1)
    x, y, z = _spread_bits(cells.astype(np.uint64)).T
    return np.argsort(x | y << np.uint64(1) | z << np.uint64(2), kind="stable")


def _spread_bits(value: np.ndarray) -> np.ndarray:
    """Move bit i of 10-bit integers to bit 3i."""
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        value = (value | value << np.uint64(shift)) & np.uint64(mask)
    return value
