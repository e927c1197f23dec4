"""Mending a mesh: what can be mended with its own triangles, in a fixed order of small steps."""

from dataclasses import dataclass, replace

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gensp.errors import DegenerateMesh
from gensp.geometry.diagnosis import degenerate_faces, half_edges
from gensp.geometry.holes import fill_holes
from gensp.geometry.mesh import Mesh, signed_volume

_ROUNDS = 20
_FLAT = 1e-14  # of the total area; the check refuses 1e-15
_NEEDLE = 1e-4  # shortest over longest side, below which a flat triangle loses that side


@dataclass(frozen=True)
class Repaired:
    """A mended mesh, and how much of what was done to it."""

    mesh: Mesh
    steps: dict[str, int]


def repair(mesh: Mesh, *, weld: float = 1e-9, largest_hole: float = 1.0) -> Repaired:
    """Mend orientation, duplicates, small holes, extra parts, non-manifold edges, flat faces.

    The result need not be sound: `require_genus_zero` decides.

    Parameters
    ----------
    weld
        Vertices closer than this part of the bounding box's diagonal are merged.
    largest_hole
        Holes are filled up to this length of their rim, in diagonals.

    Raises
    ------
    DegenerateMesh
        No triangle with an area is left.
    """
    steps: dict[str, int] = {}
    mesh = _counted(steps, "unused vertices dropped", *_without_strays(mesh))
    mesh = _counted(steps, "faces with impossible corners dropped", *_finite(mesh))
    diagonal = bounding_diagonal(mesh)
    mesh = _counted(steps, "vertices merged", *_welded(mesh, weld * diagonal))
    mesh = _counted(steps, "faces without area removed", *_without_flat(mesh))
    mesh = _counted(steps, "duplicate faces removed", *_without_duplicates(mesh))
    mesh = _counted(steps, "faces turned", *_oriented(mesh))
    mesh = _counted(steps, "vertices split at non-manifold places", *_manifold(mesh))
    mesh = _counted(steps, "faces turned after the split", *_oriented(mesh))
    mesh = _counted(steps, "parts dropped", *_largest_part(mesh))
    mesh = _counted(steps, "holes filled", *fill_holes(mesh, largest_hole * diagonal))
    mesh = _counted(steps, "mesh turned inside out", *_outward(mesh))
    return Repaired(mesh, {step: count for step, count in steps.items() if count})


def _counted(steps: dict[str, int], step: str, mesh: Mesh, count: int) -> Mesh:
    if len(mesh.faces) == 0:
        raise DegenerateMesh(
            f"{mesh.name}: no triangle with an area is left to mend; a surface is required; "
            "export it again"
        )
    steps[step] = count
    return mesh


def bounding_diagonal(mesh: Mesh) -> float:
    """Diagonal of the box around the vertices that are finite."""
    finite = mesh.vertices[np.isfinite(mesh.vertices).all(axis=1)]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 0.0


def tidy(mesh: Mesh) -> Mesh:
    """The mesh without vertices that no face uses; the order of the others is kept."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int64), mesh.name)


def sane(mesh: Mesh) -> Mesh:
    """The mesh without faces that name no vertex, or vertices that are no numbers."""
    return _finite(mesh)[0]


def _kept(mesh: Mesh, keep: Bool[np.ndarray, " m"]) -> tuple[Mesh, int]:
    return tidy(replace(mesh, faces=mesh.faces[keep])), int((~keep).sum())


def _without_strays(mesh: Mesh) -> tuple[Mesh, int]:
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.faces[(mesh.faces >= 0) & (mesh.faces < len(used))]] = True
    place = np.cumsum(used) - 1
    known = (mesh.faces >= 0) & (mesh.faces < len(used))
    faces = np.where(known, place[np.where(known, mesh.faces, 0)], -1)
    return Mesh(mesh.vertices[used], faces.astype(np.int64), mesh.name), int((~used).sum())


def _finite(mesh: Mesh) -> tuple[Mesh, int]:
    known = (mesh.faces >= 0) & (mesh.faces < len(mesh.vertices))
    finite = np.isfinite(mesh.vertices).all(axis=1)
    return _kept(mesh, np.all(known & finite[np.where(known, mesh.faces, 0)], axis=1))


def _welded(mesh: Mesh, distance: float) -> tuple[Mesh, int]:
    """Merge vertices that are joined by steps of at most `distance`, to the first of them."""
    place = _first_of_each(np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1))
    if distance > 0:
        distinct = np.unique(place)
        pairs = cKDTree(mesh.vertices[distinct]).query_pairs(distance, output_type="ndarray")
        n = len(distinct)
        near = sp.csr_array((np.ones(len(pairs), bool), pairs.T), shape=(n, n))
        cluster = connected_components(near, directed=False)[1]
        place = distinct[_first_of_each(cluster)[np.searchsorted(distinct, place)]]
    welded = tidy(replace(mesh, faces=place[mesh.faces].astype(np.int64)))
    return welded, len(mesh.vertices) - len(welded.vertices)


def _first_of_each(label: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """For every entry the place of the first with the same label."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return first[inverse.reshape(-1)]


def _without_flat(mesh: Mesh) -> tuple[Mesh, int]:
    """Collapse needles, flip caps, and drop what has a repeated corner."""
    count = 0
    for _ in range(_ROUNDS):
        flat = degenerate_faces(mesh, _FLAT)
        if not flat.any():
            break
        repeated = (np.diff(np.sort(mesh.faces, axis=1), axis=1) == 0).any(axis=1)
        if repeated.any():
            mesh, dropped = _kept(mesh, ~repeated)
        else:
            mesh, dropped = _mended_flat(mesh, np.flatnonzero(flat))
        count += dropped
        if dropped == 0 or len(mesh.faces) == 0:
            break
    return mesh, count


def _mended_flat(mesh: Mesh, flat: Int[np.ndarray, " k"]) -> tuple[Mesh, int]:
    corners = mesh.vertices[mesh.faces[flat]]
    lengths = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)
    needle = lengths.min(axis=1) <= _NEEDLE * lengths.max(axis=1)
    if needle.any():
        row = flat[needle]
        side = lengths[needle].argmin(axis=1)
        place = np.arange(len(mesh.vertices))
        place[mesh.faces[row, (side + 1) % 3]] = mesh.faces[row, side]
        # Chains of collapses end at a vertex that stays; a cycle is broken next round.
        collapsed = place[place[mesh.faces]]
        return tidy(replace(mesh, faces=collapsed)), int(needle.sum())
    return _flipped_caps(mesh, flat, lengths.argmax(axis=1))


def _flipped_caps(
    mesh: Mesh, flat: Int[np.ndarray, " k"], side: Int[np.ndarray, " k"]
) -> tuple[Mesh, int]:
    """Flip the longest side of caps, where it has one other face that no other cap takes."""
    n = len(mesh.vertices)
    sides = half_edges(mesh.faces)
    key = sides.min(axis=1) * n + sides.max(axis=1)
    order = np.argsort(key, kind="stable")
    own = 3 * flat + side
    low, high = (np.searchsorted(key[order], key[own], side=s) for s in ("left", "right"))
    pair = high - low == 2
    other = np.where(order[low] == own, order[np.minimum(low + 1, len(order) - 1)], order[low])
    face, beside = flat[pair], other[pair] // 3
    free = ~np.isin(beside, flat)
    _, first = np.unique(beside[free], return_index=True)
    chosen = np.flatnonzero(free)[first]
    if len(chosen) == 0:
        return mesh, 0
    cap, near = face[chosen], beside[chosen]
    at, across = side[pair][chosen], other[pair][chosen] % 3
    a, b, tip = (mesh.faces[cap, (at + k) % 3] for k in range(3))
    far = mesh.faces[near, (across + 2) % 3]
    faces = mesh.faces.copy()
    faces[cap], faces[near] = np.stack([a, far, tip], axis=1), np.stack([far, b, tip], axis=1)
    return replace(mesh, faces=faces), len(chosen)


def _without_duplicates(mesh: Mesh) -> tuple[Mesh, int]:
    """Keep one of several equal triangles where it closes the surface, none of a loose flap."""
    _, first, copies = np.unique(
        np.sort(mesh.faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    sides = half_edges(mesh.faces[first])
    key = sides.min(axis=1) * len(mesh.vertices) + sides.max(axis=1)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    # Sides at which an odd number of other triangles meet would be open without this one.
    needed = (count[edge.reshape(-1, 3)] % 2 == 0).sum(axis=1)
    wanted = (copies == 1) | (needed >= 2)
    keep = np.zeros(len(mesh.faces), dtype=bool)
    keep[first[wanted]] = True
    return _kept(mesh, keep)


def _manifold(mesh: Mesh) -> tuple[Mesh, int]:
    """Split vertices and edges where several sheets meet; copies come after all vertices."""
    faces, source = igl.split_nonmanifold(mesh.faces)
    source = np.asarray(source).reshape(-1)
    copies = len(source) - len(np.unique(source))
    if copies == 0:
        return mesh, 0
    _, first = np.unique(source, return_index=True)
    copied = np.ones(len(source), dtype=bool)
    copied[first] = False
    order = np.lexsort((source, copied))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    corners = place[np.asarray(faces, dtype=np.int64)]
    return tidy(Mesh(mesh.vertices[source[order]], corners, mesh.name)), copies


def _oriented(mesh: Mesh) -> tuple[Mesh, int]:
    """Turn faces until neighbours agree; in every patch the fewer of its faces."""
    faces, patch = igl.bfs_orient(mesh.faces)
    turned = (np.asarray(faces, dtype=np.int64) != mesh.faces).any(axis=1)
    patch = np.asarray(patch).reshape(-1)
    share = np.bincount(patch, weights=turned) / np.bincount(patch)
    turned ^= (share > 0.5)[patch]
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    return replace(mesh, faces=faces), int(turned.sum())


def _largest_part(mesh: Mesh) -> tuple[Mesh, int]:
    count, label = igl.facet_components(mesh.faces)
    label = np.asarray(label).reshape(-1)
    areas = np.bincount(label, weights=mesh.face_areas)
    return _kept(mesh, label == areas.argmax())[0], int(count) - 1


def _outward(mesh: Mesh) -> tuple[Mesh, int]:
    if signed_volume(mesh) >= 0:
        return mesh, 0
    return replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1])), 1
