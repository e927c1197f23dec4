"""Edges that join the parts of a graph of neighbours where they come nearest, as nearly as found.

All parts with all would be as many distances as there are pairs. Few parts are compared instead,
by few of their codes each, from which one walks along the graph to where the two are nearest.
"""

import numpy as np
import scipy.sparse.csgraph as graph
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial.distance import cdist

from gensp.geometry.approximate_neighbours import approximate_neighbours

_PARTS = 4  # the nearest by their means, to which each part is joined, beside the largest
_SAMPLE = 128  # codes of a part that are compared with as many of another


def bridges(
    codes: Float[np.ndarray, "k d"], near: Int[np.ndarray, "k c"]
) -> Int[np.ndarray, "2 e"]:
    """Edges which, together with those from every code to its neighbours, connect all codes.

    Every part is joined to the nearest others and to the largest, until one is left; of up to
    `_SAMPLE` codes each at exactly the nearest places.
    """
    rows = np.repeat(np.arange(len(codes)), near.shape[1])
    found = np.zeros((2, 0), dtype=np.int64)
    while True:
        i, j = np.concatenate([[rows, near.ravel()], found], axis=1)
        edges = coo_matrix((np.ones(len(i), dtype=bool), (i, j)), shape=(len(codes),) * 2)
        count, part = graph.connected_components(edges, directed=False)
        if count == 1:
            return found
        found = np.concatenate([found, _between(codes, near, part)], axis=1)


def _between(
    codes: Float[np.ndarray, "k d"], near: Int[np.ndarray, "k c"], part: Int[np.ndarray, " k"]
) -> Int[np.ndarray, "2 e"]:
    """An edge for every two parts that are worth joining."""
    size = np.bincount(part)
    members = np.split(np.argsort(part, kind="stable"), np.cumsum(size)[:-1])
    pairs = _worth_joining(codes, part)
    return np.array([_nearest(codes, near, members[a], members[b]) for a, b in pairs]).T


def _worth_joining(
    codes: Float[np.ndarray, "k d"], part: Int[np.ndarray, " k"]
) -> Int[np.ndarray, "p 2"]:
    """Every part with those of the nearest means and with the largest."""
    size = np.bincount(part)
    mean = csr_matrix((1 / size[part], (part, np.arange(len(part))))) @ codes
    others = approximate_neighbours(mean, _PARTS)
    others = np.concatenate([others, np.full((len(size), 1), size.argmax())], axis=1)
    pairs = np.stack([np.repeat(np.arange(len(size)), others.shape[1]), others.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def _nearest(
    codes: Float[np.ndarray, "k d"],
    near: Int[np.ndarray, "k c"],
    first: Int[np.ndarray, " a"],
    second: Int[np.ndarray, " b"],
) -> tuple[int, int]:
    """A code of each of two parts, near to each other."""
    some, others = _some(first), _some(second)
    a, b, gap = _nearest_of(codes, some, others)
    last = np.inf
    while gap < last:
        last = gap
        # A code's neighbours belong to its part.
        a, b, gap = _nearest_of(codes, np.append(near[a], a), np.append(near[b], b))
    return a, b


def _nearest_of(
    codes: Float[np.ndarray, "k d"], some: Int[np.ndarray, " s"], others: Int[np.ndarray, " o"]
) -> tuple[int, int, float]:
    between = cdist(codes[some], codes[others])
    i, j = np.unravel_index(between.argmin(), between.shape)
    return int(some[i]), int(others[j]), float(between[i, j])


def _some(members: Int[np.ndarray, " a"]) -> Int[np.ndarray, " s"]:
    count = min(len(members), _SAMPLE)
    return members[np.linspace(0, len(members) - 1, count).astype(np.int64)]
