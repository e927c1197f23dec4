"""Geodesic distances between points of a surface, by fast marching with unfolded triangles."""

import heapq

import numpy as np
from numba import njit


@njit(cache=True)
def _apart(a, b):  # fmt: skip
    """Length of b − a."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def _through(x, a, b, far_a, far_b):  # fmt: skip
    """Distance to x of a source that is far_a from a and far_b from b, by a way across ab.

    The triangle and the triangle of the source are laid into one plane, on either side of ab;
    where the straight way misses the edge, it goes round a or b.
    """
    to_a, to_b, base = _apart(x, a), _apart(x, b), _apart(a, b)
    round_ends = min(far_a + to_a, far_b + to_b)
    if base == 0.0:
        return round_ends
    along = (far_a * far_a - far_b * far_b + base * base) / (2 * base)
    below = far_a * far_a - along * along
    place = (to_a * to_a - to_b * to_b + base * base) / (2 * base)
    above = to_a * to_a - place * place
    if below < 0.0 or above <= 0.0:
        return round_ends
    down, up = np.sqrt(below), np.sqrt(above)
    across = along + (place - along) * down / (down + up)
    if across < 0.0 or across > base:
        return round_ends
    straight = np.sqrt((place - along) ** 2 + (down + up) ** 2)
    return min(straight, round_ends)


@njit(cache=True)
def _march(start, weights, goal, x, faces, first, around, distance, fixed, queue):  # fmt: skip
    """Distances from a point of a face until all corners of face `goal` have theirs.

    Returns
    -------
    list
        Vertices that were given a distance.
    """
    source = weights[0] * x[faces[start, 0]]
    source = source + weights[1] * x[faces[start, 1]] + weights[2] * x[faces[start, 2]]
    touched = [0]
    touched.clear()
    queue.clear()
    for k in range(3):
        v = faces[start, k]
        distance[v] = _apart(source, x[v])
        touched.append(v)
        heapq.heappush(queue, (distance[v], v))
    waiting = 3
    while waiting > 0 and len(queue) > 0:
        reached, v = heapq.heappop(queue)
        if fixed[v] or reached > distance[v]:
            continue
        fixed[v] = True
        waiting -= faces[goal, 0] == v or faces[goal, 1] == v or faces[goal, 2] == v
        for place in range(first[v], first[v + 1]):
            face = faces[around[place]]
            for k in range(3):
                u = face[k]
                if u == v or fixed[u]:
                    continue
                w = face[0] + face[1] + face[2] - u - v
                if np.isfinite(distance[w]):
                    far = _through(x[u], x[v], x[w], distance[v], distance[w])
                else:
                    far = distance[v] + _apart(x[u], x[v])
                if far < distance[u]:
                    if not np.isfinite(distance[u]):
                        touched.append(u)
                    distance[u] = far
                    heapq.heappush(queue, (far, u))
    return touched


@njit(cache=True)
def _inside(point, face, x, distance):  # fmt: skip
    """Distance to a point of a face whose corners have theirs."""
    least = np.inf
    for k in range(3):
        a, b = face[k], face[(k + 1) % 3]
        least = min(least, _through(point, x[a], x[b], distance[a], distance[b]))
    return least


@njit(cache=True)
def distances(starts, from_weights, goals, to_weights, x, faces, first, around):  # fmt: skip
    """Geodesic distance of every pair of points, each a face and barycentric weights.

    Parameters
    ----------
    first, around
        The faces around vertex v are around[first[v]:first[v + 1]].
    """
    found = np.empty(len(starts))
    distance, fixed = np.full(len(x), np.inf), np.zeros(len(x), np.bool_)
    queue = [(0.0, np.int64(0))]
    for k in range(len(starts)):
        goal = faces[goals[k]]
        point = to_weights[k, 0] * x[goal[0]]
        point = point + to_weights[k, 1] * x[goal[1]] + to_weights[k, 2] * x[goal[2]]
        if starts[k] == goals[k]:
            face, weights = faces[starts[k]], from_weights[k]
            source = weights[0] * x[face[0]] + weights[1] * x[face[1]] + weights[2] * x[face[2]]
            found[k] = _apart(source, point)
            continue
        touched = _march(
            starts[k], from_weights[k], goals[k], x, faces, first, around, distance, fixed, queue
        )
        found[k] = _inside(point, goal, x, distance)
        for v in touched:
            distance[v], fixed[v] = np.inf, False
    return found
