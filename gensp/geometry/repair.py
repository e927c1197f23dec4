"""Mending a mesh: what can be mended with its own triangles, in a fixed order of small steps."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gensp.errors import DegenerateMesh, Unsupported
from gensp.geometry.diagnosis import LARGEST_HOLE, Diagnosis
from gensp.geometry.flat_faces import without_flat
from gensp.geometry.holes import fill_holes
from gensp.geometry.mesh import Mesh, signed_volume
from gensp.geometry.submesh import kept, tidy
from gensp.geometry.topology import half_edges


@dataclass(frozen=True)
class Repaired:
    """A mended mesh, how much of what was done to it, and the dropped parts' share of the area."""

    mesh: Mesh
    steps: dict[str, int]
    dropped: float = 0.0


Step = Callable[[Mesh], tuple[Mesh, int]]

# The kinds of mending, in their order.
STEPS = (
    "unused",  # vertices without a face
    "finite",  # faces with corners that are missing or no numbers
    "merge",  # vertices at one place
    "flat",  # faces without area
    "duplicates",  # faces over the same corners
    "orient",  # faces against their neighbours, or inside out
    "split",  # edges and vertices where several sheets meet
    "components",  # all parts but the largest
    "holes",
)


def repair(
    mesh: Mesh,
    *,
    steps: Collection[str] = STEPS,
    weld: float = 1e-9,
    largest_hole: float = LARGEST_HOLE,
) -> Repaired:
    """Mend orientation, duplicates, small holes, extra parts, non-manifold edges, flat faces.

    The result need not be sound: `require_genus_zero` decides.

    Parameters
    ----------
    steps
        What is mended, of `STEPS`; always in the order in which they stand there.
    weld
        Vertices closer than this part of the bounding box's diagonal are merged.
    largest_hole
        Holes are filled up to this length of their rim, in diagonals.

    Raises
    ------
    DegenerateMesh
        No triangle with an area is left, or corners are impossible and "finite" is not asked for.
    Unsupported
        A step that does not exist.
    """
    require_steps(steps)
    counts: dict[str, int] = {}
    for kind, words, step in _FIRST:
        mesh = _counted(counts, words, *step(mesh)) if kind in steps else mesh
    _require_possible(mesh)
    dropped = 0.0
    for kind, words, step in _then(bounding_diagonal(mesh), weld, largest_hole):
        whole = mesh.area
        mesh = _counted(counts, words, *step(mesh)) if kind in steps else mesh
        dropped = 1 - mesh.area / whole if kind == "components" else dropped
    return Repaired(mesh, {words: count for words, count in counts.items() if count}, dropped)


def require_steps(steps: Collection[str], *, more: Collection[str] = ()) -> None:
    """Refuse a kind of mending that does not exist; `more` are allowed beside `STEPS`.

    Raises
    ------
    Unsupported
        The first unknown one, with the known ones.
    """
    unknown = [step for step in steps if step not in (*STEPS, *more)]
    if unknown:
        raise Unsupported(
            f"repair: '{unknown[0]}' is no kind of mending; some of "
            f"{', '.join((*STEPS, *more))} are required; correct the word"
        )


def remedies(found: Diagnosis) -> list[str]:
    """The kinds of mending that a diagnosis calls for, in their order; "solid" for handles."""
    wanted = {
        "unused": found.unused_vertices,
        "finite": found.not_finite or found.out_of_range,
        "merge": found.duplicate_vertices,
        "flat": found.degenerate_faces,
        "duplicates": found.duplicate_faces,
        "orient": found.misoriented_edges or found.inward,
        "split": found.nonmanifold_edges or found.nonmanifold_vertices,
        "components": found.components > 1,
        "holes": found.boundary_edges,
        "solid": found.genus,
    }
    return [kind for kind, needed in wanted.items() if needed]


def _then(diagonal: float, weld: float, largest_hole: float) -> tuple[tuple[str, str, Step], ...]:
    """The steps that need possible corners, for a mesh of this diagonal."""
    return (
        ("merge", "vertices merged", partial(_welded, distance=weld * diagonal)),
        ("flat", "faces without area removed", without_flat),
        ("duplicates", "duplicate faces removed", _without_duplicates),
        ("orient", "faces turned", _oriented),
        ("split", "vertices split at non-manifold places", _manifold),
        ("orient", "faces turned after the split", _oriented),
        ("components", "parts dropped", _largest_part),
        ("holes", "holes filled", partial(fill_holes, longest=largest_hole * diagonal)),
        ("orient", "mesh turned inside out", _outward),
    )


def _require_possible(mesh: Mesh) -> None:
    lost = len(mesh.faces) - len(_finite(mesh)[0].faces)
    if lost:
        raise DegenerateMesh(
            f"{mesh.name}: {lost} faces have corners that are missing or no numbers; only others "
            "can be mended; add 'finite' to what is mended"
        )


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


def sane(mesh: Mesh) -> Mesh:
    """The mesh without faces that name no vertex, or vertices that are no numbers."""
    return _finite(mesh)[0]


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
    return kept(mesh, np.all(known & finite[np.where(known, mesh.faces, 0)], axis=1))


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
    return kept(mesh, keep)


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
    return kept(mesh, label == areas.argmax())[0], int(count) - 1


def _outward(mesh: Mesh) -> tuple[Mesh, int]:
    if signed_volume(mesh) >= 0:
        return mesh, 0
    return replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1])), 1


_FIRST: tuple[tuple[str, str, Step], ...] = (
    ("unused", "unused vertices dropped", _without_strays),
    ("finite", "faces with impossible corners dropped", _finite),
)
