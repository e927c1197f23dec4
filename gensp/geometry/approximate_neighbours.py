"""Nearly the nearest neighbours of many codes, in less time than comparing all pairs takes.

Random trees cut the codes into leaves, within which all pairs are compared (Dasgupta and Freund,
Random projection trees and low dimensional manifolds, 2008). Then neighbours of neighbours are
tried, round after round (Dong, Moses and Li, Efficient k-nearest neighbor graph construction for
generic similarity measures, 2011). Codes that are equal are found exactly.
"""

import numpy as np
from jaxtyping import Float, Int

from gensp.compiled.neighbours import join_ranges, refine, sort_ranges

_TREES = 8
_LEAF = 64  # codes of a leaf at most, unless the lists are longer
_LENGTH = 16  # of a list at least while searching, however few are asked for
_REACH = 16  # of a list whose own neighbours are tried, the nearest
_ROUNDS = 6
_SETTLED = 0.01  # share of the lists' entries that a round may bring in and be the last


def approximate_neighbours(
    codes: Float[np.ndarray, "k d"], count: int, *, seed: int = 0
) -> Int[np.ndarray, "k c"]:
    """Of every code nearly its `count` nearest others, the nearest first.

    The same codes and seed give the same neighbours. Equal codes come first; of more than `count`
    of them each has those that follow it in a circle. Time grows a little faster than k, memory
    with k.

    Parameters
    ----------
    count
        At most k − 1 are found.
    """
    count = min(count, len(codes) - 1)
    one_of, group = _equal_codes(codes)
    near = _distinct_neighbours(codes, one_of, max(count, _LENGTH), np.random.default_rng(seed))
    return _with_twins(near, group, count)


def _equal_codes(
    codes: Float[np.ndarray, "k d"],
) -> tuple[Int[np.ndarray, " g"], Int[np.ndarray, " k"]]:
    """A code of every group of equal ones, and the group of every code."""
    # Rows are compared as bytes, in which 0 and −0 differ.
    rows = np.ascontiguousarray(codes, dtype=np.float64) + 0.0
    names = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    one_of, group = np.unique(names, return_index=True, return_inverse=True)[1:]
    return one_of, group


def _distinct_neighbours(
    codes: Float[np.ndarray, "k d"],
    one_of: Int[np.ndarray, " g"],
    length: int,
    rng: np.random.Generator,
) -> Int[np.ndarray, "g c"]:
    """Neighbours among some codes of which no two are equal, as their numbers among these."""
    count = len(one_of)
    length = min(length, count - 1)
    if length == 0:
        return np.zeros((count, 0), dtype=np.int64)
    depth = max(0, int(np.ceil(np.log2(count / max(_LEAF, 2 * length + 2)))))
    # Codes of a leaf lie side by side in memory from here on.
    order = _leaves(codes[one_of], depth, rng)
    near = _search(codes[one_of[order]], length, depth, rng)
    found = np.empty((count, length), dtype=np.int64)
    found[order] = order[near]
    return found


def _search(
    codes: Float[np.ndarray, "g d"], length: int, depth: int, rng: np.random.Generator
) -> Int[np.ndarray, "g c"]:
    near = np.full((len(codes), length), -1, dtype=np.int32)
    far, born = np.full(near.shape, np.inf), np.zeros(near.shape, dtype=np.int8)
    for tree in range(_TREES if depth else 1):
        order = _leaves(codes, depth, rng) if tree else np.arange(len(codes))
        join_ranges(codes, order, _starts(len(codes), depth), near, far, born)
    for now in range(1, _ROUNDS + 1 if depth else 1):
        if refine(codes, near, far, born, now, min(length, _REACH)) <= _SETTLED * near.size:
            break
    return near


def _leaves(
    codes: Float[np.ndarray, "g d"], depth: int, rng: np.random.Generator
) -> Int[np.ndarray, " g"]:
    """The codes leaf by leaf of a random tree that halves `depth` times."""
    order = rng.permutation(len(codes))
    for level in range(depth):
        sort_ranges(codes, order, _starts(len(codes), level), rng.random((2**level, 2)))
    return order


def _starts(count: int, depth: int) -> Int[np.ndarray, " r"]:
    return np.arange(2**depth + 1) * count // 2**depth


def _with_twins(
    near: Int[np.ndarray, "g n"], group: Int[np.ndarray, " k"], count: int
) -> Int[np.ndarray, "k c"]:
    """Neighbours of all codes from those of the groups: its own, then the nearest."""
    members = np.argsort(group, kind="stable")
    size = np.bincount(group)
    start = np.cumsum(size) - size
    rank = np.empty_like(members)
    rank[members] = np.arange(len(group)) - start[group[members]]
    every = np.arange(len(near))
    groups = np.concatenate([every[:, None], near], axis=1)
    ends = np.cumsum(size[groups], axis=1) - 1  # a code is none of its own others
    found = np.empty((len(group), count), dtype=np.int64)
    for t in range(count):
        column = (ends <= t).sum(axis=1)  # the group that the others' entry t lies in
        place = t - np.where(column > 0, ends[every, column - 1], 0)
        turned = (rank + 1 + t) % size[group]
        at = np.where((column == 0)[group], turned, place[group])
        found[:, t] = members[start[groups[every, column]][group] + at]
    return found
