"""What energies of spherical triangles share: corners, edges, and the parts of their Hessians.

Arrays run over the triangles along the last axis. Corner k is opposite to edge k, which goes from
corner k + 1 to corner k + 2.
"""

import numpy as np
from jaxtyping import Float, Int

_PAIRS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # corners (u, v) of a pair and the corner opposite


def gathered(
    x: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3 3 m"]:
    """Vectors at the corners of every triangle: corner, component, triangle."""
    return np.ascontiguousarray(x.T[:, faces.T].swapaxes(0, 1))


def gathered_frames(
    frames: Float[np.ndarray, "n 3 2"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3 2 3 m"]:
    """Tangent frames at the corners: corner, tangent, component, triangle."""
    return np.stack([gathered(frames[:, :, k], faces) for k in (0, 1)], axis=1)


def summed_at_vertices(
    corners: Float[np.ndarray, "3 3 m"], faces: Int[np.ndarray, "m 3"], count: int
) -> Float[np.ndarray, "n 3"]:
    """Sum of the vectors at all corners of each of `count` vertices."""
    at = faces.T.reshape(-1)
    columns = [np.bincount(at, corners[:, k].reshape(-1), count) for k in range(3)]
    return np.stack(columns, axis=1)


def edges_of(corners: Float[np.ndarray, "3 3 m"]) -> Float[np.ndarray, "3 3 m"]:
    """Chords opposite to the corners."""
    return corners[[2, 0, 1]] - corners[[1, 2, 0]]


def dot(a: Float[np.ndarray, "*k 3 m"], b: Float[np.ndarray, "*l 3 m"]) -> np.ndarray:
    """Inner product over the components."""
    return np.sum(a * b, axis=-2)


def cross(a: Float[np.ndarray, "*k 3 m"], b: Float[np.ndarray, "*l 3 m"]) -> np.ndarray:
    """Cross product over the components."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -2, 0), np.moveaxis(b, -2, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-2)


def determinants(
    corners: Float[np.ndarray, "3 3 m"], edges: Float[np.ndarray, "3 3 m"]
) -> Float[np.ndarray, " m"]:
    """det(u_a, u_b, u_c), by differences: the plain product loses the sign of tiny triangles."""
    return dot(corners[0], cross(edges[1], edges[2]))


def determinant_gradients(corners: Float[np.ndarray, "3 3 m"]) -> Float[np.ndarray, "3 3 m"]:
    """Derivatives of det(u_a, u_b, u_c) by the corners."""
    return cross(corners[[1, 2, 0]], corners[[2, 0, 1]])


def tangential(
    tangents: Float[np.ndarray, "3 2 3 m"], gradients: Float[np.ndarray, "3 3 m"]
) -> Float[np.ndarray, "6 m"]:
    """Derivatives by the corners in the coordinates of their tangent planes."""
    return dot(tangents, gradients[:, None]).reshape(6, -1)


def curvature_blocks(
    corners: Float[np.ndarray, "3 3 m"],
    tangents: Float[np.ndarray, "3 2 3 m"],
    by_edge: Float[np.ndarray, "3 m"],
    by_determinant: Float[np.ndarray, " m"],
    gradients: Float[np.ndarray, "3 3 m"],
) -> Float[np.ndarray, "6 6 m"]:
    """Part of a Riemannian Hessian that is linear in the slopes of the energy.

    For an energy of the squared chords |e_k|² and the determinant: their own second derivatives,
    times the slopes `by_edge` and `by_determinant`. Moving along x means
    u ← (u + T x)/‖u + T x‖ = u + T x − ½|x|² u + …, which adds −(g·u) I to the block of a corner
    with gradient g.
    """
    blocks = np.zeros((6, 6, corners.shape[-1]))
    for one, two, opposite in _PAIRS:
        across = cross(tangents[two], corners[opposite][None])
        moved = by_determinant * across - 2 * by_edge[opposite] * tangents[two]
        block = dot(tangents[one][:, None], moved[None])
        first, second = slice(2 * one, 2 * one + 2), slice(2 * two, 2 * two + 2)
        blocks[first, second] = block
        blocks[second, first] = block.swapaxes(0, 1)
    normal = dot(gradients, corners)
    for k in range(3):
        stiff = 2 * (by_edge[(k + 1) % 3] + by_edge[(k + 2) % 3])
        blocks[[2 * k, 2 * k + 1], [2 * k, 2 * k + 1]] = stiff - normal[k]
    return blocks
