"""From a predicted surface to a spherical map of the input's own triangles, free of folds."""

from dataclasses import dataclass

import igl
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import unit


def invert(
    points: Float[np.ndarray, "n 3"], generated: Mesh, sphere: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "n 3"]:
    """Sphere positions of points through a generated surface.

    Every point goes to the closest point of the generated surface, whose barycentric weights are
    read on the sphere.

    Parameters
    ----------
    points
        Vertices of the input.
    generated
        Image of a triangulated sphere under the generator.
    sphere
        Unit positions of the generated surface's vertices.
    """
    return unit(closest_point(points, generated).at.on(sphere, generated.faces))


@dataclass(frozen=True)
class Untangled:
    """A repaired map: unit positions (n, 3), rounds of smoothing, and whether no fold is left."""

    sphere: Float[np.ndarray, "n 3"]
    rounds: int
    clean: bool


def untangle(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    max_rounds: int = 60,
    sweeps: int = 60,
    first_ring: int = 3,
    last_ring: int = 40,
    thinness: float = 1e-7,
) -> Untangled:
    """Smooth a spherical map around its bad faces until no face is folded.

    The vertices around every bad face, out to a ring that widens from round to round, move to the
    normalised mean of their neighbours (Tutte's embedding, relaxed on the sphere); the rest of the
    map stays as it is. Bad is what the exact predicate calls folded or flat. A face whose
    height is less than `thinness` of its longest side is smoothed along with its folded
    neighbours, at whatever scale it lies, but does not by itself keep a map from being clean.

    Parameters
    ----------
    max_rounds, sweeps
        Rounds before giving up, and averaging sweeps in each.
    first_ring, last_ring
        Width of the smoothed neighbourhood in edges, in the first round and at most.
    """
    u = unit(sphere)
    adjacency = scipy.sparse.csr_matrix(igl.adjacency_matrix(faces), dtype=np.float64)
    for count in range(max_rounds + 1):
        folded = bad_faces(u, faces)
        if not folded.any():
            return Untangled(u, count, True)
        if count < max_rounds:
            around = _ring(faces[folded | thin_faces(u, faces, thinness)], adjacency, first_ring)
            u = _smoothed(u, adjacency, around, sweeps)
            first_ring = min(first_ring + 1, last_ring)
    return Untangled(u, max_rounds, False)


def thin_faces(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], thinness: float
) -> Bool[np.ndarray, " m"]:
    """Faces whose height is below `thinness` times their longest side."""
    corners = sphere[faces]
    sides = corners[:, [1, 2, 0]] - corners
    longest = np.einsum("mki,mki->mk", sides, sides).max(axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return twice_area <= thinness * longest


def _ring(
    faces: Int[np.ndarray, "b 3"], adjacency: scipy.sparse.csr_matrix, width: int
) -> Int[np.ndarray, " k"]:
    reached = np.zeros(adjacency.shape[0])
    reached[faces] = 1
    for _ in range(width):
        reached = np.minimum(reached + adjacency @ reached, 1)
    return np.flatnonzero(reached)


def _smoothed(
    u: Float[np.ndarray, "n 3"],
    adjacency: scipy.sparse.csr_matrix,
    moving: Int[np.ndarray, " k"],
    sweeps: int,
) -> Float[np.ndarray, "n 3"]:
    u, rows = u.copy(), adjacency[moving]
    for _ in range(sweeps):
        mean = unit(rows @ u)
        # Opposite neighbours cancel to no direction: such a vertex waits for the next sweep.
        u[moving] = np.where(mean.any(axis=1, keepdims=True), mean, u[moving])
    return u
