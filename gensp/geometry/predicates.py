"""Exact orientation of spherical triangles and the degree of a spherical map."""

import igl
import igl.predicates
import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.errors import NotEmbeddable

# Of the determinant of three unit vectors in floating point: sure to be more than its error.
_DOUBT = 1e-12


def spherical_orientation(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, " m"]:
    """Exact sign of det(u_a, u_b, u_c): 1 outward, -1 folded over, 0 without area.

    Uses the adaptive orient3d predicate against the centre; there is no tolerance.
    """
    return _signs(*(sphere[faces[:, k]] for k in range(3)))


def _signs(
    a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"], c: Float[np.ndarray, "k 3"]
) -> Int[np.ndarray, " k"]:
    """Exact signs of det(a, b, c)."""
    rows = [np.ascontiguousarray(x) for x in (a, b, c)]
    sign = igl.predicates.orient3d(*rows, np.zeros((len(a), 3)))
    return np.sign(np.asarray(sign).reshape(-1)).astype(np.int64)


def bad_faces(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    """Faces that are folded over or without area, after the map's global orientation."""
    orientation = spherical_orientation(sphere, faces)
    # The majority decides: a mirrored map is not a folded one.
    return orientation * (1 if orientation.sum() >= 0 else -1) <= 0


def spherical_areas(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " m"]:
    """Signed solid angles of the spherical triangles (Van Oosterom–Strackee)."""
    a, b, c = (sphere[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = 1 + np.sum(a * b, axis=1) + np.sum(b * c, axis=1) + np.sum(c * a, axis=1)
    return 2 * np.arctan2(volume, dots)


def map_degree(sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> int:
    """How often the map of a closed surface winds around the sphere; exact, folded or not.

    Raises
    ------
    NotEmbeddable
        Positions that are not finite or not unit vectors.
    """
    require_unit(sphere)
    return signed_preimages(sphere, faces, spherical_orientation(sphere, faces))


def require_unit(sphere: Float[np.ndarray, "n 3"]) -> None:
    """Refuse positions that no sphere has.

    Raises
    ------
    NotEmbeddable
        Positions that are not finite or not unit vectors.
    """
    length = np.linalg.norm(sphere, axis=1)
    if not np.isfinite(length).all() or (np.abs(length - 1) > 1e-6).any():
        raise NotEmbeddable("sphere positions must be finite unit vectors to have a degree")


def signed_preimages(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    orientation: Int[np.ndarray, " m"],
) -> int:
    """Faces that hold one generic direction, counted by their exact orientation: the degree.

    Of a closed surface the count is the same for every direction that lies on no edge's great
    circle; such a one is drawn.
    """
    rng = np.random.default_rng(0)
    while True:
        holding = _holding(rng.standard_normal(3), sphere, faces, orientation)
        if holding is not None:
            return int(orientation[holding].sum())


def _holding(
    direction: Float[np.ndarray, " 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    orientation: Int[np.ndarray, " m"],
) -> Int[np.ndarray, " k"] | None:
    """Faces whose spherical triangle has the direction inside, None if it is on a border."""
    p = direction / np.linalg.norm(direction)
    normals = np.cross(p, sphere)
    left = np.flatnonzero(orientation)
    for k in range(3):
        a, b = faces[left, k], faces[left, (k + 1) % 3]
        side = orientation[left] * np.einsum("ij,ij->i", normals[a], sphere[b])
        left = left[side > -_DOUBT]
    corners = sphere[faces[left]]
    ps = np.repeat(p[None], len(left), axis=0)
    sides = [_signs(ps, corners[:, k], corners[:, (k + 1) % 3]) for k in range(3)]
    inside = (np.stack(sides) * orientation[left]).min(axis=0)
    return None if (inside == 0).any() else left[inside > 0]
