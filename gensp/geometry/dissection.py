"""Nested dissection of a mesh graph: what to eliminate together, and in which order."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

_LEAF = 32  # vertices that are not cut any further


@dataclass(frozen=True)
class Part:
    """Vertices that are eliminated together, after all those of the parts `children`."""

    vertices: Int[np.ndarray, " k"]
    children: tuple[int, ...]


def nested_dissection(graph: sp.csr_matrix, points: Float[np.ndarray, "n 3"]) -> list[Part]:
    """Parts of a mesh graph in the order of elimination: halves first, what is between them last.

    Every set is cut at the median of its widest direction; the separator is the near side of the
    cut. Fill is O(n log n) on surface meshes (George 1973).
    """
    parts: list[Part] = []
    across = np.zeros(graph.shape[0], dtype=bool)

    def dissected(whole: np.ndarray) -> tuple[int, ...]:
        """Put the parts of a set at the end of the list; the places of those that end it."""
        if len(whole) <= _LEAF:
            return _put(parts, whole, ())
        near, separator, far = _cut(graph, points, whole, across)
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
    graph: sp.csr_matrix, points: np.ndarray, part: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    centred = points[part] - points[part].mean(axis=0)
    widest = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    rank = np.argsort(centred @ widest, kind="stable")
    near, far = part[rank[: len(part) // 2]], part[rank[len(part) // 2 :]]
    across[far] = True
    rows = graph[near]
    touches = np.add.reduceat(across[rows.indices], rows.indptr[:-1]) > 0
    across[far] = False
    return near[~touches], near[touches], far
