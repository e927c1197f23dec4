"""Trees over the latent codes of a collection; correspondences are carried along them (§4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse.csgraph as graph
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, issparse
from scipy.spatial.distance import cdist

from gensp.errors import Unsupported
from gensp.geometry.approximate_neighbours import approximate_neighbours
from gensp.geometry.bridges import bridges

ALL_PAIRS = 2000  # codes up to which all pairs of them are looked at
_BLOCK = 2**15  # edges that are measured at a time
_NO_PARENT = -1


@dataclass(frozen=True)
class Tree:
    """A rooted spanning tree over k shapes.

    Attributes
    ----------
    parent
        Parent of every node (k,), -1 at the root.
    order
        All nodes (k,), parents before children.
    weight
        Latent distance of every node to its parent (k,), 0 at the root.
    """

    parent: Int[np.ndarray, " k"]
    order: Int[np.ndarray, " k"]
    weight: Float[np.ndarray, " k"]

    def path(self, node: int) -> list[int]:
        """Nodes from the root to `node`."""
        path = [int(node)]
        while self.parent[path[-1]] != _NO_PARENT:
            path.append(int(self.parent[path[-1]]))
        return path[::-1]

    def depth(self) -> Int[np.ndarray, " k"]:
        """Number of edges between the root and every node."""
        depth = np.zeros(len(self.parent), dtype=np.int64)
        for node in self.order[1:]:
            depth[node] = depth[self.parent[node]] + 1
        return depth


def spanning_tree(codes: Float[np.ndarray, "k d"], root: int, kind: str = "minimum") -> Tree:
    """Spanning tree of the graph of latent distances, rooted at the sphere.

    `minimum` is the paper's minimum spanning tree; `shortest` the tree of shortest paths for
    squared distances, which is shallower; `star` joins every shape to the root (No-GP). The graph
    is complete up to `ALL_PAIRS` codes; of more it is that of `latent_neighbours`.

    Raises
    ------
    Unsupported
        Another kind.
    """
    if kind not in ("minimum", "shortest", "star"):
        raise Unsupported(
            f"tree kind '{kind}' is unknown; minimum, shortest or star is required; "
            "set recipe.correspond.tree"
        )
    distance = _distances(codes, root, kind)
    if kind == "star":
        parent = np.full(len(codes), root)
        order = np.concatenate([[root], np.delete(np.arange(len(codes)), root)])
    else:
        order, parent = _paths(distance, root, kind)
    parent = np.array(parent, dtype=np.int64)
    parent[root] = root
    if issparse(distance):
        weight = np.linalg.norm(codes - codes[parent], axis=1)
    else:
        weight = distance[np.arange(len(codes)), parent]
    parent[root], weight[root] = _NO_PARENT, 0
    return Tree(parent, np.array(order, dtype=np.int64), weight)


def _distances(codes: Float[np.ndarray, "k d"], root: int, kind: str) -> Any:
    if len(codes) <= ALL_PAIRS:
        return cdist(codes, codes)
    return latent_neighbours(codes, root, to_root=kind == "shortest")


def _paths(distance: Any, root: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Order and parents of a tree in a graph of distances, dense or sparse."""
    sparse = issparse(distance)
    if kind == "minimum":
        edges = graph.minimum_spanning_tree(_stored(distance))
        order, parent = graph.breadth_first_order(edges, root, directed=False)
        return order, parent
    cost = _stored(distance.power(2) if sparse else np.square(distance))
    # A sparse graph has every edge once.
    length, parent = graph.dijkstra(
        cost, directed=not sparse, indices=root, return_predecessors=True
    )
    return np.argsort(length, kind="stable"), parent


def latent_neighbours(
    codes: Float[np.ndarray, "k d"], root: int, *, count: int = 16, to_root: bool = False
) -> csr_matrix:
    """Distances (k, k) of every code to nearly its nearest others, as a connected sparse graph.

    Parts that hang together in no other way are joined where they come nearest, see `bridges`.
    Memory grows with k alone, time a little faster.

    Parameters
    ----------
    to_root
        Whether every code is joined to the root too.
    """
    near = approximate_neighbours(codes, count)
    rows = np.repeat(np.arange(len(codes)), near.shape[1])
    edges = [np.stack([rows, near.ravel()]), bridges(codes, near)]
    if to_root:
        edges.append(np.stack([np.full(len(codes), root), np.arange(len(codes))]))
    ends = np.sort(np.concatenate(edges, axis=1), axis=0)
    i, j = np.divmod(np.unique(ends[0] * len(codes) + ends[1]), len(codes))
    i, j = i[i != j], j[i != j]
    return csr_matrix((_lengths(codes, i, j), (i, j)), shape=(len(codes),) * 2)


def _lengths(
    codes: Float[np.ndarray, "k d"], i: Int[np.ndarray, " e"], j: Int[np.ndarray, " e"]
) -> Float[np.ndarray, " e"]:
    """Distances between codes, some edges at a time: all their differences need much memory."""
    parts = range(0, len(i), _BLOCK)
    some = [(i[k : k + _BLOCK], j[k : k + _BLOCK]) for k in parts]
    return np.concatenate([np.linalg.norm(codes[a] - codes[b], axis=1) for a, b in some])


def _stored(cost: Any) -> Any:
    # A zero in the matrix reads as "no edge": twins are joined by a negligible cost instead.
    least = 1e-12 * max(float(cost.max()), 1.0)
    if issparse(cost):
        cost.data = np.maximum(cost.data, least)
        return cost
    return np.where(np.eye(len(cost), dtype=bool), 0, np.maximum(cost, least))


def ancestors(
    tree: Tree, targets: Sequence[int] | Int[np.ndarray, " t"]
) -> Bool[np.ndarray, " k"]:
    """Which nodes lie on a path from the root to one of `targets`, ends included."""
    used = np.zeros(len(tree.parent), dtype=bool)
    used[np.asarray(targets, dtype=np.int64)] = True
    for node in tree.order[:0:-1]:
        used[tree.parent[node]] |= used[node]
    return used


def along_path(
    points: Float[np.ndarray, "k d"], count: int
) -> tuple[Float[np.ndarray, "c d"], Int[np.ndarray, " c"]]:
    """Points at equal distances along a polyline, its ends included.

    Returns
    -------
    (c, d) array, (c,) array
        The points, and of each the vertex that its segment ends in.
    """
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(length)])
    at = np.linspace(0, reached[-1], count)
    found = np.stack([np.interp(at, reached, column) for column in points.T], axis=1)
    # The start lies on the first segment; rounding may put the last beyond the end.
    last = len(points) - 1
    return found, np.clip(np.searchsorted(reached, at), min(1, last), last).astype(np.int64)
