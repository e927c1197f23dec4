"""Whether triangles make one closed oriented surface of genus 0: their indices alone decide."""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components


class Fault(NamedTuple):
    """What keeps triangles from being a sphere, in the parts of a message."""

    found: str
    required: str
    remedy: str


def sphere_fault(faces: Int[np.ndarray, "m 3"], count: int) -> Fault | None:
    """The first fault of a triangulated sphere with `count` vertices, None if it has none.

    Every index is a vertex and every vertex is used; every directed side occurs once, and so does
    the opposite one; the faces hang together through their sides; V − E + F = 2. Then the faces
    around every vertex are one fan: splitting the others apart would add to V, beyond 2.
    """
    fault = _index_fault(faces, count)
    if fault:
        return fault
    opposite = opposite_sides(faces, count)
    if opposite is None:
        return _side_fault(faces)
    euler, neighbours = count - len(opposite) // 2 + len(faces), _neighbours(opposite)
    # A walk from one face takes an eighth of the time of counting the parts.
    reached = breadth_first_order(neighbours, 0, return_predecessors=False)
    if len(reached) == len(faces) and euler == 2:
        return None
    parts = int(connected_components(neighbours, directed=False, return_labels=False))
    return _whole_fault(opposite, count, parts, euler)


def known_faces(faces: Int[np.ndarray, "m 3"], count: int) -> Bool[np.ndarray, " m"]:
    """Faces all of whose corners are among `count` vertices."""
    return np.asarray(((faces >= 0) & (faces < count)).all(axis=1))


def half_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "h 2"]:
    """Start and end of the three sides of every face, one face after the other."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def opposite_sides(faces: Int[np.ndarray, "m 3"], count: int) -> Int[np.ndarray, " h"] | None:
    """For each of `half_edges` the one in the other direction, None unless each has just one."""
    start, end = half_edges(faces.astype(np.int32)).T
    # A matrix of sides sorts them by counting; places of repeated sides would be added up.
    places = np.arange(len(start), dtype=np.int32)
    sides = sp.csr_array((places, (start, end)), shape=(count, count))
    turned = sides.T.tocsr()
    single = sides.nnz == len(start) and bool((start != end).all())
    if not (single and np.array_equal(sides.indptr, turned.indptr)):
        return None
    if not np.array_equal(sides.indices, turned.indices):
        return None
    opposite = np.empty_like(places)
    opposite[sides.data] = turned.data
    return opposite


def edge_counts(faces: Int[np.ndarray, "m 3"]) -> dict[str, int]:
    """Edges with one face, with more than two, and with two that run through them alike."""
    sides = half_edges(faces)
    # One number per edge: rows sort ten times slower.
    n = int(faces.max()) + 1
    undirected = sides.min(axis=1) * n + sides.max(axis=1)
    _, edge, count = np.unique(undirected, return_inverse=True, return_counts=True)
    forward = np.bincount(edge.reshape(-1), weights=sides[:, 0] < sides[:, 1])
    return {
        "boundary_edges": int((count == 1).sum()),
        "nonmanifold_edges": int((count > 2).sum()),
        "misoriented_edges": int(((count == 2) & (forward != 1)).sum()),
    }


def _index_fault(faces: Int[np.ndarray, "m 3"], count: int) -> Fault | None:
    if len(faces) == 0:
        return Fault("there are no faces", "a triangle mesh is required", "export it again")
    outside = int((~known_faces(faces, count)).sum())
    if outside:
        return Fault(
            f"{outside} faces name vertices outside the {count}",
            "indices within the vertex list are required",
            "export it again",
        )
    unused = int((np.bincount(faces.reshape(-1), minlength=count) == 0).sum())
    if unused:
        return Fault(f"{unused} vertices belong to no face", "none is allowed", "remove them")
    return None


def _side_fault(faces: Int[np.ndarray, "m 3"]) -> Fault:
    found = edge_counts(faces)
    required = "a closed manifold is required"
    if found["nonmanifold_edges"]:
        what = f"{found['nonmanifold_edges']} edges with more than two faces (non-manifold)"
        return Fault(what, required, "split or remesh it")
    if found["boundary_edges"]:
        what = f"{found['boundary_edges']} boundary edges (open surface)"
        return Fault(what, required, "close the holes")
    return Fault(
        "neighbouring faces disagree in orientation",
        "one consistent outward orientation is required",
        "reorient the faces",
    )


def _whole_fault(opposite: Int[np.ndarray, " h"], count: int, parts: int, euler: int) -> Fault:
    if _fans(opposite) != count:
        return Fault(
            "a vertex joins several sheets (non-manifold)",
            "a closed manifold is required",
            "split the vertex",
        )
    if parts > 1:
        return Fault(
            f"{parts} connected components",
            "exactly one is required",
            "keep the largest or join them",
        )
    return Fault(
        f"Euler characteristic {euler} (genus {1 - euler // 2})",
        "genus 0 is required",
        "cut the handles and close them",
    )


def _neighbours(opposite: Int[np.ndarray, " h"]) -> sp.csr_array:
    """The faces next to each face."""
    rows = np.arange(0, len(opposite) + 1, 3, dtype=np.int32)
    return sp.csr_array((np.ones(len(opposite)), opposite // 3, rows))


def _fans(opposite: Int[np.ndarray, " h"]) -> int:
    """Number of closed fans of faces around vertices.

    Turning about its start, a half-edge is followed by the opposite of the one before it in its
    face; every orbit is a fan.
    """
    follower = opposite.reshape(-1, 3)[:, [2, 0, 1]].reshape(-1)
    turns = sp.csr_array((np.ones(len(follower)), follower, np.arange(len(follower) + 1)))
    return int(connected_components(turns, return_labels=False))
