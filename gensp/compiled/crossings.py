"""Which edges of a grid of unit cells pass through triangles."""

import numpy as np
from numba import njit

_REACH = 1e-4  # cells: triangles are so much larger, so that no edge slips between two


@njit(cache=True)
def crossed_edges(corners, shape):  # fmt: skip
    """For every axis and grid point: whether the edge to the next point meets a triangle.

    `corners` (m, 3, 3) are in cells, `shape` counts the points. Triangles along an axis cross no
    edge of it.
    """
    crossed = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.bool_)
    for t in range(len(corners)):
        for axis in range(3):
            _cross(corners[t], axis, shape, crossed[axis])
    return crossed


@njit(cache=True)
def _cross(triangle, axis, shape, crossed):  # fmt: skip
    """Mark the edges along one axis that meet a triangle."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    bu, bv = triangle[1, u] - triangle[0, u], triangle[1, v] - triangle[0, v]
    cu, cv = triangle[2, u] - triangle[0, u], triangle[2, v] - triangle[0, v]
    double = bu * cv - bv * cu
    longest = max(np.hypot(bu, bv), np.hypot(cu, cv), np.hypot(cu - bu, cv - bv))
    if abs(double) < 1e-12 * longest * longest or double == 0.0:
        return
    slack = _REACH * longest / abs(double)
    low, high = np.zeros(2), np.zeros(2)
    for k, other in enumerate((u, v)):
        low[k] = max(np.ceil(triangle[:, other].min() - _REACH), 0)
        high[k] = min(np.floor(triangle[:, other].max() + _REACH), shape[other] - 1)
    place = np.zeros(3, dtype=np.int64)
    for i in range(int(low[0]), int(high[0]) + 1):
        for j in range(int(low[1]), int(high[1]) + 1):
            pu, pv = i - triangle[0, u], j - triangle[0, v]
            b, c = (pu * cv - pv * cu) / double, (bu * pv - bv * pu) / double
            if b < -slack or c < -slack or 1 - b - c < -slack:
                continue
            along = triangle[0, axis] * (1 - b - c) + triangle[1, axis] * b + triangle[2, axis] * c
            place[u], place[v] = i, j
            for k in range(int(np.floor(along - _REACH)), int(np.floor(along + _REACH)) + 1):
                if 0 <= k < shape[axis]:
                    place[axis] = k
                    crossed[place[0], place[1], place[2]] = True
