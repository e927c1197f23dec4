"""Lists of nearest codes: leaves of random trees, then neighbours of neighbours.

Three arrays hold the lists of all codes, the nearest first: `near` (k, c) who, -1 where nobody is
yet, `far` (k, c) how far, squared, and `born` (k, c) the round in which each came in.
"""

import numpy as np
from numba import njit


# Sums may be taken in any order, which lets the processor take several terms at a time.
@njit(cache=True, fastmath={"reassoc"})
def _square(codes, i, j):
    """Squared distance of two codes."""
    total = 0.0
    for k in range(codes.shape[1]):
        step = codes[i, k] - codes[j, k]
        total += step * step
    return total


@njit(cache=True, fastmath={"reassoc"})
def _height(codes, i, a, b):
    """How far code i is along the direction from code b to code a."""
    total = 0.0
    for k in range(codes.shape[1]):
        total += codes[i, k] * (codes[a, k] - codes[b, k])
    return total


@njit(cache=True)
def _push(near, far, born, i, at, gap, now):  # fmt: skip
    """Put `at` into the list of i, unless it is there or too far; whether it came in."""
    last = far.shape[1] - 1
    if gap >= far[i, last]:
        return False
    place = last
    while place > 0 and far[i, place - 1] > gap:
        place -= 1
    k = place - 1
    while k >= 0 and far[i, k] == gap:
        if near[i, k] == at:
            return False
        k -= 1
    for k in range(last, place, -1):
        near[i, k], far[i, k], born[i, k] = near[i, k - 1], far[i, k - 1], born[i, k - 1]
    near[i, place], far[i, place], born[i, place] = at, gap, now
    return True


@njit(cache=True)
def sort_ranges(codes, order, starts, picks):
    """Sort every range of codes along the direction between two of its codes.

    Parameters
    ----------
    order
        Codes, range by range; changed in place.
    starts
        (r + 1,) where ranges begin and the last ends; each has two codes or more.
    picks
        (r, 2) in [0, 1): which two codes of a range give the direction.
    """
    for k in range(len(starts) - 1):
        mine = order[starts[k] : starts[k + 1]].copy()
        first = int(picks[k, 0] * len(mine))
        second = (first + 1 + int(picks[k, 1] * (len(mine) - 1))) % len(mine)
        heights = np.empty(len(mine))
        for t in range(len(mine)):
            heights[t] = _height(codes, mine[t], mine[first], mine[second])
        order[starts[k] : starts[k + 1]] = mine[np.argsort(heights)]


@njit(cache=True)
def join_ranges(codes, order, starts, near, far, born):
    """Compare all codes of every range with each other."""
    for k in range(len(starts) - 1):
        for s in range(starts[k], starts[k + 1]):
            i = order[s]
            for t in range(starts[k], s):
                j = order[t]
                gap = _square(codes, i, j)
                _push(near, far, born, i, j, gap, 0)
                _push(near, far, born, j, i, gap, 0)


@njit(cache=True)
def _back_lists(near, far, born, reach):
    """Of every code the nearest `reach` of those in whose lists it is, and their rounds."""
    back, gaps = np.full((len(near), reach), -1, near.dtype), np.full((len(near), reach), np.inf)
    ages = np.zeros((len(near), reach), born.dtype)
    for i in range(len(near)):
        for t in range(reach):
            j = near[i, t]
            if j >= 0:
                _push(back, gaps, ages, j, i, far[i, t], born[i, t])
    return back, ages


@njit(cache=True)
def _row(lists, dates, i, reach, who, when, size):
    """Append the first `reach` of the list of i; the new size."""
    for t in range(reach):
        if lists[i, t] >= 0:
            who[size], when[size] = lists[i, t], dates[i, t]
            size += 1
    return size


@njit(cache=True)
def refine(codes, near, far, born, now, reach):
    """Compare every code with the neighbours of its neighbours, both ways; how many came in.

    Of every list the nearest `reach` are walked, and only by ways new since round `now` - 1.
    """
    back, ages = _back_lists(near, far, born, reach)
    seen = np.full(len(near), -1, np.int64)
    around, since = np.empty(2 * reach, np.int64), np.empty(2 * reach, np.int64)
    beyond, after = np.empty_like(around), np.empty_like(since)
    came = 0
    for i in range(len(near)):
        seen[i] = i
        for t in range(near.shape[1]):
            if near[i, t] >= 0:
                seen[near[i, t]] = i
        size = _row(near, born, i, reach, around, since, 0)
        size = _row(back, ages, i, reach, around, since, size)
        for s in range(size):
            more = _row(near, born, around[s], reach, beyond, after, 0)
            more = _row(back, ages, around[s], reach, beyond, after, more)
            for t in range(more):
                j = beyond[t]
                if seen[j] != i and max(since[s], after[t]) >= now - 1:
                    seen[j] = i
                    gap = _square(codes, i, j)
                    came += _push(near, far, born, i, j, gap, now)
                    came += _push(near, far, born, j, i, gap, now)
    return came
