"""Exact orientation of spherical triangles and the degree of a spherical map."""

import igl
import igl.predicates
import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.errors import NotEmbeddable


def spherical_orientation(
    sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, " m"]:
    """Exact sign of det(u_a, u_b, u_c): 1 outward, -1 folded over, 0 without area.

    Uses the adaptive orient3d predicate against the centre; there is no tolerance.
    """
    corners = [np.ascontiguousarray(sphere[faces[:, k]]) for k in range(3)]
    centre = np.zeros((1, 3))
    sign = igl.predicates.orient3d(*corners, np.repeat(centre, len(faces), axis=0))
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
    """How often the map winds around the sphere: signed area over 4π, an integer.

    Raises
    ------
    NotEmbeddable
        Positions that are not finite or not unit vectors.
    """
    length = np.linalg.norm(sphere, axis=1)
    if not np.isfinite(length).all() or np.abs(length - 1).max() > 1e-6:
        raise NotEmbeddable("sphere positions must be finite unit vectors to have a degree")
    return int(np.rint(spherical_areas(sphere, faces).sum() / (4 * np.pi)))
