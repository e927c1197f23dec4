"""Nested dissection of a mesh graph: what to eliminate together, and in which order."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

_LEAF = 32  # vertices that are not cut any further
_MANY = 64  # neighbours; a vertex with more is put into the separator before they are
_LONG = 3.0  # times √k: separators of k vertices, on evenly spaced meshes, are shorter


@dataclass(frozen=True)
class Part:
    """Vertices that are eliminated together, after all those of the parts `children`."""

    vertices: Int[np.ndarray, " k"]
    children: tuple[int, ...]


def nested_dissection(graph: sp.csr_matrix, points: Float[np.ndarray, "n 3"]) -> list[Part]:
    """Parts of a mesh graph in the order of elimination: halves first, what is between them last.

    Every set is cut at the median of its widest direction, or of another one where thin triangles
    lie across that cut; the separator is the near side of the cut, but instead of many neighbours
    of one vertex that vertex. Fill is O(n log n) on surface meshes (George 1973).
    """
    parts: list[Part] = []
    across = np.zeros(graph.shape[0], dtype=bool)
    hubs = np.diff(graph.indptr) > _MANY

    def dissected(whole: np.ndarray) -> tuple[int, ...]:
        """Put the parts of a set at the end of the list; the places of those that end it."""
        if len(whole) <= _LEAF:
            return _put(parts, whole, ())
        near, separator, far = _cut(graph, points, whole, hubs, across)
        return _put(parts, separator, dissected(near) + dissected(far))

    dissected(np.arange(graph.shape[0]))
    return parts


def _put(parts: list[Part], vertices: np.ndarray, children: tuple[int, ...]) -> tuple[int, ...]:
    """Add a part, unless nothing is between its children."""
    if len(vertices) == 0:
        return children
    parts.append(Part(vertices, children))
    return (len(parts) - 1,)


def _cut(
    graph: sp.csr_matrix,
    points: np.ndarray,
    part: np.ndarray,
    hubs: np.ndarray,
    across: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Near side, separator, far side, by the widest direction whose separator is not long."""
    centred = points[part] - points[part].mean(axis=0)
    cuts = []
    for direction in np.linalg.eigh(centred.T @ centred)[1].T[::-1]:
        rank = np.argsort(centred @ direction, kind="stable")
        near, far = part[rank[: len(part) // 2]], part[rank[len(part) // 2 :]]
        cuts.append(_separated(graph, near, far, hubs, across))
        if len(cuts[-1][1]) <= _LONG * np.sqrt(len(part)):
            return cuts[-1]
    return min(cuts, key=lambda cut: len(cut[1]))


def _separated(
    graph: sp.csr_matrix, near: np.ndarray, far: np.ndarray, hubs: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What of the near side does not touch the far side, what separates them, the far side."""
    across[far] = True
    rows = graph[near]
    met = np.unique(rows.indices[across[rows.indices] & hubs[rows.indices]])
    across[met] = False
    touches = np.add.reduceat(across[rows.indices], rows.indptr[:-1]) > 0
    beyond = far[across[far]]
    across[far] = False
    return near[~touches], np.concatenate([near[touches], met]), beyond
