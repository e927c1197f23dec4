"""Correspondences from the sphere to every shape, along a tree of shapes (paper §4.3, App. B.3).

The icosphere is carried outward, from the root to the leaves: on every node its vertices are
points of the node's own mesh, and a registered edge takes them to the child by their barycentric
coordinates. Pulled the other way, shapes arrive on the sphere with many folds (errata).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gensp.geometry.distance import ClosestPointTree, barycentric_coordinates
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.registration import folded
from gensp.geometry.spanning_tree import Tree

_NO_PARENT = -1
_CANDIDATES = 64
_NOT_MUCH_FARTHER = 3.0
_COLLAPSED = 1e-4


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
