"""Correspondences from the sphere to every shape, along a tree of shapes (paper §4.3, App. B.3).

The icosphere is carried outward, from the root to the leaves: on every node its vertices are
points of the node's own mesh, and a registered edge takes them to the child by their barycentric
coordinates. Pulled the other way, shapes arrive on the sphere with many folds (errata).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse.csgraph as graph
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix, csr_matrix, issparse
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gensp.errors import Unsupported
from gensp.geometry.distance import ClosestPointTree, barycentric_coordinates
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.registration import folded

ALL_PAIRS = 2000  # codes up to which all pairs of them are looked at
_NO_PARENT = -1
_CANDIDATES = 64
_NOT_MUCH_FARTHER = 3.0
_COLLAPSED = 1e-4


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
    """Distances (k, k) of every code to its nearest others, as a connected sparse graph.

    Parts that hang together with the root in no other way are joined where they come nearest to
    its part. Memory grows with k alone.

    Parameters
    ----------
    to_root
        Whether every code is joined to the root too.
    """
    far, near = cKDTree(codes).query(codes, k=min(count + 1, len(codes)))
    rows = np.repeat(np.arange(len(codes)), near.shape[1])
    edges = [np.stack([rows, near.ravel()])]
    found = coo_matrix((far.ravel() + 1, edges[0]), shape=(len(codes),) * 2)
    edges.append(_bridges(codes, graph.connected_components(found, directed=False)[1], root))
    if to_root:
        edges.append(np.stack([np.full(len(codes), root), np.arange(len(codes))]))
    i, j = np.unique(np.sort(np.concatenate(edges, axis=1), axis=0), axis=1)
    i, j = i[i != j], j[i != j]
    length = np.sqrt(np.square(codes[i] - codes[j]).sum(axis=1))
    return csr_matrix((length, (i, j)), shape=(len(codes),) * 2)


def _bridges(
    codes: Float[np.ndarray, "k d"], part: Int[np.ndarray, " k"], root: int
) -> Int[np.ndarray, "2 e"]:
    """One edge from every part but the root's to the root's part, where they come nearest."""
    home, others = np.flatnonzero(part == part[root]), np.flatnonzero(part != part[root])
    if len(others) == 0:
        return np.zeros((2, 0), dtype=np.int64)
    gap, at = cKDTree(codes[home]).query(codes[others])
    nearest = np.lexsort((gap, part[others]))
    chosen = nearest[np.unique(part[others][nearest], return_index=True)[1]]
    return np.stack([others[chosen], home[at[chosen]]])


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


@dataclass(frozen=True)
class Correspondence:
    """Where the icosphere's vertices lie on one shape.

    Attributes
    ----------
    at
        The N vertices as points of the shape's mesh.
    points
        The same as positions (N, 3).
    valid
        Vertices (N,) without a folded or collapsed triangle around them (App. B.4).
    fold_rate
        Share of the icosphere's triangles that are folded or collapsed.
    """

    at: SurfacePoints
    points: Float[np.ndarray, "k 3"]
    valid: Bool[np.ndarray, " k"]
    fold_rate: float


def carry(
    points: SurfacePoints,
    faces: Int[np.ndarray, "m 3"],
    registered: Float[np.ndarray, "n 3"],
    child: Mesh,
) -> SurfacePoints:
    """Take points of a parent's mesh across one registered edge onto the child's mesh.

    `registered` are the parent's vertices bent onto the child and `faces` the parent's faces.
    The barycentric coordinates name positions on the bent parent, and the closest points of
    those are points of the child: the stitching of App. B.3.
    """
    bent = Mesh(registered, faces)
    return closest_agreeing(
        points.on(registered, faces), points.on(bent.vertex_normals, faces), child
    )


def propagate(
    tree: Tree,
    wanted: Bool[np.ndarray, " k"],
    *,
    mesh: Callable[[int], Mesh],
    registered: Callable[[int], Float[np.ndarray, "n 3"]],
    sphere: Mesh,
) -> Iterator[tuple[int, Correspondence]]:
    """Carry the icosphere `sphere` outward along the tree; yields wanted nodes, parents first.

    `mesh(i)` is the mesh of node i and `registered(i)` the vertices of its parent's mesh bent
    onto it. `wanted` must hold all ancestors of its nodes.
    """
    carried: dict[int, SurfacePoints] = {}
    for node in (int(i) for i in tree.order if wanted[i]):
        parent, here = int(tree.parent[node]), mesh(node)
        if parent == _NO_PARENT:
            carried[node] = ClosestPointTree(here).query(sphere.vertices).at
        else:
            faces = mesh(parent).faces
            carried[node] = carry(carried[parent], faces, registered(node), here)
        yield node, correspondence(carried[node], here, sphere.faces)


def correspondence(at: SurfacePoints, mesh: Mesh, faces: Int[np.ndarray, "f 3"]) -> Correspondence:
    """Positions of carried vertices and the mask of those outside folds.

    A triangle of the carried icosphere (`faces`) is folded when its normal opposes the surface
    normals met at its corners, and collapsed when its area is negligible.
    """
    points = at.on(mesh.vertices, mesh.faces)
    bad = faces_at_fault(Mesh(points, faces), at, mesh)
    valid = np.ones(len(points), dtype=bool)
    valid[faces[bad]] = False
    return Correspondence(at, points, valid, float(bad.mean()))


def faces_at_fault(image: Mesh, at: SurfacePoints, mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """Triangles of an icosphere's image that are folded or collapsed on a shape.

    Parameters
    ----------
    at
        Where the image's vertices lie on the shape, or next to which point of it.
    """
    met = mesh.face_normals[at.faces][image.faces].sum(axis=1)
    return folded(image, met) | (image.face_areas <= _COLLAPSED * image.face_areas.mean())


def closest_agreeing(
    positions: Float[np.ndarray, "k 3"], normals: Float[np.ndarray, "k 3"], mesh: Mesh
) -> SurfacePoints:
    """Closest points whose surface normal agrees with the given one, where such are at hand.

    Beside a thin limb the closest point may lie on its far side. A point whose nearest face
    looks the other way takes the nearest agreeing face instead, if that is not much farther.
    """
    found = ClosestPointTree(mesh).query(positions)
    agreement = np.einsum("kj,kj->k", normals, mesh.face_normals[found.at.faces])
    doubtful = np.flatnonzero(agreement <= 0)
    if len(doubtful) == 0:
        return found.at
    other, distance = _nearest_agreeing(positions[doubtful], normals[doubtful], mesh)
    better = distance <= _NOT_MUCH_FARTHER * found.distance[doubtful]
    face, weights = found.at.faces.copy(), found.at.barycentric.copy()
    face[doubtful[better]] = other.faces[better]
    weights[doubtful[better]] = other.barycentric[better]
    return SurfacePoints(face, weights)


def _nearest_agreeing(
    positions: Float[np.ndarray, "k 3"], normals: Float[np.ndarray, "k 3"], mesh: Mesh
) -> tuple[SurfacePoints, Float[np.ndarray, " k"]]:
    """Best of the faces with the nearest centres that agree, and its distance (inf: none)."""
    triangles = mesh.vertices[mesh.faces]
    count = min(_CANDIDATES, len(triangles))
    near = np.asarray(cKDTree(triangles.mean(axis=1)).query(positions, k=count)[1], dtype=np.int64)
    near = near.reshape(len(positions), count)
    repeated = np.repeat(positions, count, axis=0)
    weights = barycentric_coordinates(repeated, triangles[near.reshape(-1)])
    candidate = SurfacePoints(near.reshape(-1), weights)
    gap = np.linalg.norm(candidate.on(mesh.vertices, mesh.faces) - repeated, axis=1)
    agreement = np.einsum("kj,kcj->kc", normals, mesh.face_normals[near])
    gap = np.where(agreement > 0, gap.reshape(near.shape), np.inf)
    best = np.arange(len(near)) * count + gap.argmin(axis=1)
    return candidate.take(best), gap.reshape(-1)[best]
