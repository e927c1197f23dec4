"""A graph of registrations, and the tree in it that strains shapes least (ours)."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse.csgraph as graph
from jaxtyping import Float

from gensp.geometry.correspondence import Tree

_NO_PARENT = -1


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
    cost = np.full((count, count), np.inf)
    for (i, j), strain in strains.items():
        # A strain of exactly zero would read as "no edge".
        cost[i, j] = cost[j, i] = max(strain, 1e-12)
    edges = graph.csgraph_from_dense(cost, null_value=np.inf)
    root = _centre(graph.shortest_path(edges, directed=False))
    order, parent = graph.breadth_first_order(
        graph.minimum_spanning_tree(edges), root, directed=False
    )
    parent = np.where(parent < 0, _NO_PARENT, parent).astype(np.int64)
    weight = np.where(parent < 0, 0.0, cost[np.arange(count), parent])
    rest = np.setdiff1d(np.arange(count), order)
    return Tree(parent, np.concatenate([order, rest]).astype(np.int64), weight)


def _centre(lengths: Float[np.ndarray, "k k"]) -> int:
    """Of the nodes that reach most others, the one with the shortest ways."""
    reached = np.isfinite(lengths)
    ways = np.where(reached, lengths, 0).sum(axis=1)
    return int(np.lexsort((ways, -reached.sum(axis=1)))[0])


def reached_nodes(tree: Tree) -> Sequence[int]:
    """The root and all nodes below it, parents first."""
    root = int(tree.order[0])
    return [int(k) for k in tree.order if k == root or tree.parent[k] != _NO_PARENT]
