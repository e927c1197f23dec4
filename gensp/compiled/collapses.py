"""Half-edge collapses in the order of quadric error, all together or in independent sets."""

import heapq

import numpy as np
from numba import njit

from gensp.compiled.halfedges import collapse, following, ring, turned
from gensp.compiled.hubs import HUB, account, find_hubs, joined

BASE = 4  # vertices of the tetrahedron
_SHORT = 1e-3  # where the surface is flat, short edges go first
_MANY = 10  # neighbours; more make a collapse dear
_SMALL = 1e-6  # weight of 1/(smallest area)² at unit area (Schmidt et al. 2023)
_FLATTEST = 1e-7  # area of a triangle over its longest side squared that a collapse may leave


@njit(cache=True)
def _quadric_error(a: np.ndarray, b: np.ndarray, x: np.ndarray) -> float:
    """Value at x of the sum of two quadrics, 10 numbers each."""
    q = a + b
    square = (
        q[0] * x[0] * x[0] + 2 * q[1] * x[0] * x[1] + 2 * q[2] * x[0] * x[2]
        + q[3] * x[1] * x[1] + 2 * q[4] * x[1] * x[2] + q[5] * x[2] * x[2]
    )  # fmt: skip
    return max(square + q[6] * x[0] + q[7] * x[1] + q[8] * x[2] + q[9], 0.0)


@njit(cache=True)
def _triangle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[float, float]:
    """Area and square of the longest side."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    longest = max(longest, wx * wx + wy * wy + wz * wz)
    return 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz), longest


@njit(cache=True)
def _cost(
    around: np.ndarray,
    size: int,
    v: int,
    valence: int,
    x: np.ndarray,
    q: np.ndarray,
    independent: bool,
) -> float:
    """Cost of moving v into around[0], its ring being around[:size]; infinite where flat."""
    w = around[0]
    star, worst, smallest = 0.0, 1.0, np.inf
    for k in range(1, size - 1):
        area, longest = _triangle(x[w], x[around[k]], x[around[k + 1]])
        if area <= _FLATTEST * longest:
            return np.inf
        worst = max(worst, 0.4330127 * longest / area)
        smallest = min(smallest, area)
        star += area
    if independent:
        return _quadric_error(q[v], q[w], x[w]) + _SMALL / (smallest * smallest)
    ex, ey, ez = x[v, 0] - x[w, 0], x[v, 1] - x[w, 1], x[v, 2] - x[w, 2]
    many = max(1.0, (size + valence - 4) / _MANY)
    error = _quadric_error(q[v], q[w], x[w])
    return (error + _SHORT * (ex * ex + ey * ey + ez * ez) * star) * worst * many * many


@njit(cache=True)
def _linked(around, size, origin, twin, leaving, hub, between):
    """Whether v and around[0] have two neighbours in common, the ring of v being around[:size]."""
    w = around[0]
    if hub[w]:
        for k in range(2, size - 1):
            if joined(around[k], w, origin, twin, leaving, hub, between):
                return False
        return True
    at, common = leaving[w], 0
    while True:
        tip = origin[following(at)]
        for k in range(1, size):
            common += tip == around[k]
        at = turned(at, twin)
        if at == leaving[w]:
            return common == 2


@njit(cache=True)
def _best(v, shape, between, around, independent):
    """Cheapest allowed collapse of v: its cost and half-edge."""
    x, q, origin, twin, leaving, valence, hub = shape
    least, chosen = np.inf, -1
    start = leaving[v]
    at = start
    while True:
        size = ring(at, origin, twin, around)
        if _linked(around, size, origin, twin, leaving, hub, between):
            cost = _cost(around, size, v, valence[around[0]], x, q, independent)
            if cost < least:
                least, chosen = cost, at
        at = turned(at, twin)
        if at == start:
            return least, chosen


@njit(cache=True)
def _candidates(shape, between, around, version, most, independent):
    """Heap of the best collapse of every vertex that is left and has `most` neighbours at most.

    An infinite cost is its bottom.
    """
    x, _, _, _, _, valence, _ = shape
    heap = [(np.inf, 0, 0, 0)]
    for v in range(len(x)):
        if version[v] >= 0 and valence[v] <= most:
            cost, h = _best(v, shape, between, around, independent)
            if h >= 0:
                heap.append((cost, v, h, version[v]))
    heapq.heapify(heap)
    return heap


@njit(cache=True)
def _renew(v, heap, shape, between, around, version, independent):
    """Replace what the heap says of v; a hub waits until it has few neighbours."""
    version[v] += 1
    if shape[5][v] > HUB:
        return
    cost, h = _best(v, shape, between, around, independent)
    if h >= 0:
        heapq.heappush(heap, (cost, v, h, version[v]))


@njit(cache=True)
def _renew_ring(around, size, heap, shape, between, other, version, independent):
    """Replace what the heap says of around[:size]; in an independent set they have to wait."""
    for k in range(size):
        if independent:
            version[around[k]] += 1
        else:
            _renew(around[k], heap, shape, between, other, version, independent)


@njit(cache=True)
def _collapsed(h, around, shape, between):
    """Collapse h where the link condition holds; gives the size of the ring, or 0."""
    _, q, origin, twin, leaving, valence, hub = shape
    v, size = origin[h], ring(h, origin, twin, around)
    if not _linked(around, size, origin, twin, leaving, hub, between):
        return 0
    collapse(h, origin, twin, leaving)
    account(around, size, origin, twin, leaving, valence, hub, between)
    for k in range(10):
        q[around[0], k] += q[v, k]
    return size


@njit(cache=True)
def collapse_all(
    x: np.ndarray, q: np.ndarray, origin: np.ndarray, twin: np.ndarray, leaving: np.ndarray,
    independent: bool,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Collapse to a tetrahedron, cheapest first; gives the collapsed half-edges, and their sets.

    `q` (n, 10) are the vertices' quadrics; those of collapsed ones are added on. `independent`:
    the neighbours of a collapsed vertex stay until no other collapse is left, which ends a set.
    """
    n, most = len(x), HUB
    around, other = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    order, version = np.empty(max(n - BASE, 0), dtype=np.int64), np.zeros(n, dtype=np.int64)
    sets, between = np.zeros_like(order), set(order[:0])
    valence, hub = find_hubs(origin, twin, leaving, between)
    shape = (x, q, origin, twin, leaving, valence, hub)
    heap = _candidates(shape, between, around, version, most, independent)
    done, first, current = 0, 0, 0
    while done < n - BASE:
        cost, v, h, made = heapq.heappop(heap)
        if cost == np.inf:
            if done == first and most == n:
                break
            # A hub goes only where nothing else can.
            most = HUB if done > first else n
            current += independent and done > first
            first = done
            heap = _candidates(shape, between, around, version, most, independent)
            continue
        if made != version[v]:
            continue
        size = _collapsed(h, around, shape, between)
        if size == 0:
            # The tip has got new neighbours meanwhile.
            _renew(v, heap, shape, between, other, version, independent)
            continue
        version[v] = -1
        order[done], sets[done] = h, current
        done += 1
        _renew_ring(around, size, heap, shape, between, other, version, independent)
    return order[:done], sets[:done]
