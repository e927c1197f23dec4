"""A graph of registrations, and the tree in it that strains shapes least (ours)."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse.csgraph as graph
from scipy.sparse import csr_matrix

from gensp.geometry.spanning_tree import ALL_PAIRS, Tree

_NO_PARENT = -1
_LANDMARKS = 64


def least_strained_tree(count: int, strains: Mapping[tuple[int, int], float]) -> Tree:
    """Minimum spanning tree by strain, hung from the node that has all others nearest.

    Like shapes come to hang together, and slide alike. Nodes that no edge joins to the root's part
    are left without parent, at the end of the order.

    Parameters
    ----------
    count
        Number of nodes.
    strains
        Of undirected edges (i, j).
    """
    pairs = np.array(list(strains), dtype=np.int64).reshape(-1, 2)
    # A strain of exactly zero would read as "no edge".
    values = np.maximum(np.array(list(strains.values()), dtype=np.float64), 1e-12)
    edges = csr_matrix(
        (np.tile(values, 2), np.concatenate([pairs, pairs[:, ::-1]]).T), (count,) * 2
    )
    root = _centre(edges)
    order, parent = graph.breadth_first_order(
        graph.minimum_spanning_tree(edges), root, directed=False
    )
    parent = np.where(parent < 0, _NO_PARENT, parent).astype(np.int64)
    weight = np.asarray(edges[np.arange(count), np.maximum(parent, 0)]).ravel()
    weight = np.where(parent < 0, 0.0, weight)
    rest = np.setdiff1d(np.arange(count), order)
    return Tree(parent, np.concatenate([order, rest]).astype(np.int64), weight)


def _centre(edges: csr_matrix) -> int:
    """Of the nodes that reach most others, the one with the shortest ways.

    Above `ALL_PAIRS` nodes the ways to `_LANDMARKS` of them count alone.
    """
    count = edges.shape[0]
    ends = np.arange(count)
    if count > ALL_PAIRS:
        ends = np.linspace(0, count - 1, _LANDMARKS, dtype=np.int64)
    lengths = graph.dijkstra(edges, directed=False, indices=ends)
    reached = np.isfinite(lengths)
    ways = np.where(reached, lengths, 0).sum(axis=0)
    return int(np.lexsort((ways, -reached.sum(axis=0)))[0])


def reached_nodes(tree: Tree) -> Sequence[int]:
    """The root and all nodes below it, parents first."""
    root = int(tree.order[0])
    return [int(k) for k in tree.order if k == root or tree.parent[k] != _NO_PARENT]
