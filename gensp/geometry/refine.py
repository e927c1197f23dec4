"""From a predicted surface to a spherical map of the input's own triangles, free of folds."""

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from gensp.geometry.distance import closest_point
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import bad_faces, spherical_areas
from gensp.geometry.sphere import unit

_POLISHING = 5
_SHRINKING = (0.05, 200.0)  # outside, a prediction tells nothing but that it is wrong


@dataclass(frozen=True)
class Inverted:
    """Sphere positions (n, 3) of points through a generated surface, and how far it was (n,)."""

    sphere: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]


def invert(
    points: Float[np.ndarray, "n 3"], generated: Mesh, sphere: Float[np.ndarray, "k 3"]
) -> Inverted:
    """Sphere positions of points through a generated surface.

    Every point goes to the closest point of the generated surface, whose barycentric weights are
    read on the sphere.

    Parameters
    ----------
    points
        Vertices of the input.
    generated
        Image of a triangulated sphere under the generator.
    sphere
        Unit positions of the generated surface's vertices.
    """
    found = closest_point(points, generated)
    return Inverted(unit(found.at.on(sphere, generated.faces)), found.distance)


def reliability(
    predicted: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    distance: Float[np.ndarray, " n"],
    *,
    reach: float = 0.1,
) -> Float[np.ndarray, " n"]:
    """How far a predicted map can be trusted at every vertex, in [0, 1].

    1/(1 + (d/r)²) of the distance d to the generated surface, times the share of faces around
    the vertex that the prediction does not fold.

    Parameters
    ----------
    distance
        From the vertices to the surface that the prediction was read from, at area 4π.
    reach
        r, where trust has fallen to a half.
    """
    bad = bad_faces(predicted, faces).astype(np.float64)
    corners = faces.reshape(-1)
    around = np.bincount(corners, minlength=len(predicted))
    folded = np.bincount(corners, np.repeat(bad, 3), len(predicted)) / np.maximum(around, 1)
    return (1 - folded) / (1 + (distance / reach) ** 2)


def shrinking(
    sphere: Float[np.ndarray, "n 3"], mesh: Mesh, *, rings: int = 3
) -> Float[np.ndarray, " n"]:
    """How much smaller a map, folded or not, makes the surroundings of every vertex.

    Area of the surface over that of the sphere, both summed over neighbourhoods that widen to
    about `rings` edges, within `_SHRINKING`. Its root turns distances on the sphere into distances
    on the surface.

    Parameters
    ----------
    mesh
        At area 4π.
    """
    count = len(mesh.vertices)
    areas = np.stack([mesh.face_areas, np.abs(spherical_areas(sphere, mesh.faces))])
    corners = mesh.faces.reshape(-1)
    around = np.stack([np.bincount(corners, np.repeat(row, 3), count) for row in areas], axis=1)
    spread = scipy.sparse.eye_array(count) + igl.adjacency_matrix(mesh.faces)
    for _ in range(rings):
        around = spread @ around
    surface, covered = around.T
    ratio: Float[np.ndarray, " n"] = surface / np.maximum(covered, surface / _SHRINKING[1])
    return np.maximum(ratio, _SHRINKING[0])


@dataclass(frozen=True)
class Untangled:
    """A repaired map: unit positions (n, 3), rounds of smoothing, and whether no fold is left."""

    sphere: Float[np.ndarray, "n 3"]
    rounds: int
    clean: bool


def untangle(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    areas: Float[np.ndarray, " m"] | None = None,
    crowding: float = 1e-2,
    max_rounds: int = 40,
    first_ring: int = 2,
    largest_patch: float = 0.45,
    thinness: float = 1e-6,
) -> Untangled:
    """Re-embed the surroundings of bad faces until no face is folded.

    The vertices around every bad face, out to a ring that widens from round to round, become the
    harmonic extension with unit weights of the rest, projected to the sphere; the rest of the map
    stays as it is. Seen from the centre (gnomonic projection) that is Tutte's embedding (1963)
    with positive weights, so a patch inside a hemisphere with a convex rim has no folds.

    Bad is what the exact predicate calls folded or flat, and what `thin_faces` calls flat for its
    own size. The latter does not keep a map from being clean.

    Parameters
    ----------
    areas
        Areas of the surface's faces. With them, faces that hold less than `crowding` of their
        share of the sphere are re-embedded as well, in the first round: the retracted limbs that
        make the refinement slow.
    max_rounds, first_ring
        Rounds before giving up; width of the smoothed neighbourhood in edges in the first round.
    largest_patch
        Share of the sphere that the smoothed patches may cover; wider rings are cut back.
    """

    def still_wrong(u: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " m"]:
        return _wrong_faces(u, faces, thinness, largest_patch)

    u = unit(sphere)
    wrong = still_wrong(u)
    if areas is not None:
        wrong |= _crowded_faces(u, faces, areas, crowding)
    return _smoothed(u, faces, wrong, still_wrong, max_rounds, first_ring, largest_patch)


def _crowded_faces(
    u: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    areas: Float[np.ndarray, " m"],
    crowding: float,
) -> Bool[np.ndarray, " m"]:
    """Faces that hold less than `crowding` of their share of the sphere."""
    share = np.abs(spherical_areas(u, faces)) / (4 * np.pi)
    return share < crowding * areas / areas.sum()


def _smoothed(
    u: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    wrong: Bool[np.ndarray, " m"],
    still_wrong: Callable[[np.ndarray], np.ndarray],
    max_rounds: int,
    ring: int,
    largest: float,
) -> Untangled:
    """Rounds of smoothing around what is wrong; the last map without bad faces, if any."""
    best = Untangled(u, 0, not bad_faces(u, faces).any())
    adjacency = scipy.sparse.csr_matrix(igl.adjacency_matrix(faces), dtype=np.float64)
    rounds = 0
    while wrong.any() and rounds < max_rounds:
        moving, ring = _patch(u, faces, wrong, adjacency, ring, largest)
        if len(moving) == len(u):
            break  # nothing is left to hold the rest
        u, rounds = harmonic_patch(u, adjacency, moving), rounds + 1
        wrong = still_wrong(u)
        if not bad_faces(u, faces).any():
            best = Untangled(u, rounds, True)
            # What is left is thin, not folded: a few rounds more may round it off.
            max_rounds = min(max_rounds, rounds + _POLISHING)
    return best if best.clean else Untangled(u, rounds, False)


def _wrong_faces(
    u: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    thinness: float,
    largest: float,
) -> Bool[np.ndarray, " m"]:
    """Bad and thin faces; bad ones alone where the thin ones are too large to be re-embedded."""
    bad = bad_faces(u, faces)
    wrong = bad | thin_faces(u, faces, thinness)
    reached = np.zeros(len(u), dtype=bool)
    reached[faces[wrong]] = True
    return wrong if _covered(u, faces, reached) <= largest else bad


def _covered(
    u: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], reached: Bool[np.ndarray, " n"]
) -> float:
    """Share of the sphere under the faces around some vertices, overlaps counted again."""
    touched = reached[faces].any(axis=1)
    return float(np.abs(spherical_areas(u, faces[touched])).sum() / (4 * np.pi))


def thin_faces(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], thinness: float
) -> Bool[np.ndarray, " m"]:
    """Spherical triangles that are flat for their own size: |det(u_a, u_b, u_c)| ≤ ε · longest².

    That is a height below ε times the longest side, or a plane almost through the centre.
    """
    corners = sphere[faces]
    sides = corners[:, [1, 2, 0]] - corners
    longest = np.einsum("mki,mki->mk", sides, sides).max(axis=1)
    volume = np.einsum("mi,mi->m", corners[:, 0], np.cross(sides[:, 0], sides[:, 1]))
    return np.abs(volume) <= thinness * longest


def _patch(
    u: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    wrong: Bool[np.ndarray, " m"],
    adjacency: scipy.sparse.csr_matrix,
    ring: int,
    largest: float,
) -> tuple[Int[np.ndarray, " k"], int]:
    """Vertices within `ring` edges of the wrong faces, and the ring to take next time."""
    reached = np.zeros(len(u), dtype=bool)
    reached[faces[wrong]] = True
    for width in range(ring):
        wider = reached | (adjacency @ reached > 0)
        if wider.all() or _covered(u, faces, wider) > largest:
            # A rim beyond the hemisphere would turn the patch inside out: start narrow again.
            return np.flatnonzero(reached), max(1, width // 2)
        reached = wider
    return np.flatnonzero(reached), ring + 1


def harmonic_patch(
    sphere: Float[np.ndarray, "n 3"],
    adjacency: scipy.sparse.csr_matrix,
    moving: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "n 3"]:
    """Put every moving vertex at the normalised mean of its neighbours, all others held.

    Parameters
    ----------
    adjacency
        Ones (n, n) between neighbours; at least one vertex must be held.
    """
    held = np.ones(len(sphere), dtype=bool)
    held[moving] = False
    rows = adjacency[moving]
    laplacian = scipy.sparse.diags(np.asarray(rows.sum(axis=1)).reshape(-1)) - rows[:, moving]
    moved = unit(SPDSolver(laplacian, sphere[moving]).solve(rows[:, held] @ sphere[held]))
    result = sphere.copy()
    # The mean of opposite points has no direction: such a vertex stays where it is.
    result[moving] = np.where(moved.any(axis=1, keepdims=True), moved, sphere[moving])
    return result
