"""The kernel of a ring on the sphere: all points that see the whole spherical polygon."""

import numpy as np
from numba import njit


@njit(cache=True)
def _normals(around: np.ndarray, size: int, u: np.ndarray, star: np.ndarray) -> bool:
    """Unit normals of the great circles along the ring, into the first columns of `star`."""
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        sx, sy, sz = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
        nx = u[a, 1] * sz - u[a, 2] * sy
        ny = u[a, 2] * sx - u[a, 0] * sz
        nz = u[a, 0] * sy - u[a, 1] * sx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0:
            return False
        star[k, 0], star[k, 1], star[k, 2] = nx / length, ny / length, nz / length
    return True


@njit(cache=True)
def _turned(n: np.ndarray, p: np.ndarray, out: np.ndarray) -> None:
    """A quarter turn of p about n: where an edge of the kernel is halved, which is no corner."""
    out[0] = n[1] * p[2] - n[2] * p[1]
    out[1] = n[2] * p[0] - n[0] * p[2]
    out[2] = n[0] * p[1] - n[1] * p[0]
    out[3] = 0.0


@njit(cache=True)
def _determinant(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """(a × b) · c."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return x * c[0] + y * c[1] + z * c[2]


@njit(cache=True)
def _crossing(a: np.ndarray, b: np.ndarray, da: float, db: float, out: np.ndarray) -> None:
    """The corner between a and b, which are on different sides of a great circle."""
    da, db = abs(da), abs(db)
    x, y, z = db * a[0] + da * b[0], db * a[1] + da * b[1], db * a[2] + da * b[2]
    length = np.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2], out[3] = x / length, y / length, z / length, 1.0


@njit(cache=True)
def _clip(n: np.ndarray, corners: np.ndarray, count: int, out: np.ndarray) -> int:
    """Clip a convex polygon by the great circle of normal n; gives the number of its corners.

    Edges are a quarter of a circle at most, or their ends would not tell where they run.
    """
    size = 0
    for k in range(count):
        a, b = corners[k], corners[(k + 1) % count]
        da = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
        db = n[0] * b[0] + n[1] * b[1] + n[2] * b[2]
        if da >= 0:
            out[size] = a
            size += 1
        if (da >= 0) != (db >= 0):
            _crossing(a, b, da, db, out[size])
            size += 1
        if da < 0 and db >= 0 and size > 1:
            p, q = out[size - 2], out[size - 1]
            if p[0] * q[0] + p[1] * q[1] + p[2] * q[2] < 0:
                out[size] = q
                _turned(n, p, out[size - 1])
                size += 1
    return size


@njit(cache=True)
def kernel_centre(
    around: np.ndarray, size: int, u: np.ndarray, star: np.ndarray, out: np.ndarray
) -> bool:
    """Mean direction of the kernel's corners, for a ring that around[0] sees: it is one of them.

    The lune of the two great circles that meet there is clipped by the others, one by one.
    """
    if not _normals(around, size, u, star):
        return False
    corners, clipped = np.empty((2 * size + 8, 4)), np.empty((2 * size + 8, 4))
    first, last, count = star[0], star[size - 1], 4
    if _determinant(last, first, u[around[0]]) < 0:  # more than half a turn within the ring
        first, last = last, first
    corners[0, :3], corners[0, 3] = u[around[0]], 1.0
    corners[2, :3], corners[2, 3] = -u[around[0]], 1.0
    _turned(first, corners[0], corners[1])
    _turned(last, corners[2], corners[3])
    for k in range(1, size - 1):
        count = _clip(star[k], corners, count, clipped)
        corners, clipped = clipped, corners
    for c in range(3):
        out[c] = 0.0
        for k in range(count):
            out[c] += corners[k, 3] * corners[k, c]
    length = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if length < 1e-12:
        return False
    for c in range(3):
        out[c] /= length
    return True
