"""Texture coordinates of a spherical map in one rectangular picture, with sound seam and poles.

A picture of longitudes and latitudes has a seam, where u jumps from 1 to 0, and two poles, where
u means nothing. Triangles across the seam get copies of their vertices with u + 1 (the picture
repeats), every triangle at a pole its own copy of the pole's vertex, and a pole that lies within a
triangle becomes a vertex. A triangle without a pole inside spans less than half of the longitudes,
so no triangle of the result runs across the picture.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import spherical_orientation

_POLE = 1e-14  # distance from the axis below which a vertex has no longitude


def equirectangular(p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """Longitude and latitude of unit vectors as (u, v): u in [0, 1), v = 1 at the pole +z."""
    u = np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi) % 1
    height = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))
    # The remainder of a tiny negative angle is rounded to one.
    return np.stack([np.where(u < 1, u, 0), 0.5 + height / np.pi], axis=1)


def equirectangular_directions(height: int) -> Float[np.ndarray, "height width 3"]:
    """Unit vectors at the pixel centres of a picture twice as wide as high, top row at +z."""
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    longitude = 2 * np.pi * ((np.arange(2 * height) + 0.5) / (2 * height))[None]
    level = np.cos(latitude)
    parts = (level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude))
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


@dataclass(frozen=True)
class Unwrapped:
    """A surface with a texture coordinate at every vertex.

    Attributes
    ----------
    vertices, sphere
        Positions (k, 3) on the surface and on the sphere, repeated where the picture is cut.
    uv
        Texture coordinates (k, 2), origin at the lower left; u may exceed 1 (repeat).
    faces
        Triangles (q, 3): those of the map, split where a pole lies within.
    source
        Vertex of the map (k,) that each is a copy of; inserted poles come after all others.
    """

    vertices: Float[np.ndarray, "k 3"]
    sphere: Float[np.ndarray, "k 3"]
    uv: Float[np.ndarray, "k 2"]
    faces: Int[np.ndarray, "q 3"]
    source: Int[np.ndarray, " k"]

    def whole(self) -> tuple[Mesh, Int[np.ndarray, " k"]]:
        """The surface without cuts, and the place of every copy among its vertices."""
        _, first, place = np.unique(self.source, return_index=True, return_inverse=True)
        place = place.reshape(-1).astype(np.int64)
        return Mesh(self.vertices[first], place[self.faces]), place


def unwrap(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Unwrapped:
    """Cut a spherical map open along the seam and at the poles of its texture."""
    for pole in (1.0, -1.0):
        surface, sphere, faces = _with_pole(surface, sphere, faces, pole)
    uv = equirectangular(sphere)
    at_pole = _on_axis(sphere)
    u = _continued(uv[faces, 0], at_pole[faces])
    # A copy of a vertex for every turn of u, and for every corner at a pole.
    turn = np.rint(u - uv[faces, 0]).astype(np.int64)
    corner = np.arange(faces.size).reshape(faces.shape)
    copy = np.where(at_pole[faces], 2 * len(sphere) + corner, 2 * faces + turn)
    _, first, inverse = np.unique(copy, return_index=True, return_inverse=True)
    vertex = faces.reshape(-1)[first]
    placed = np.stack([u.reshape(-1)[first], uv[vertex, 1]], axis=1)
    cut = inverse.reshape(faces.shape).astype(np.int64)
    return Unwrapped(surface[vertex], sphere[vertex], placed, cut, vertex)


def _continued(
    u: Float[np.ndarray, "m 3"], at_pole: Bool[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 3"]:
    """Longitudes of every triangle's corners without jumps, the smallest in [0, 1)."""
    row = np.arange(len(u))
    reference = u[row, np.argmin(at_pole, axis=1)][:, None]
    u = u - np.rint(u - reference)
    u = u - np.floor(np.where(at_pole, np.inf, u).min(axis=1, keepdims=True))
    others = np.where(at_pole, 0, u).sum(axis=1, keepdims=True)
    return np.where(at_pole, others / np.maximum((~at_pole).sum(axis=1, keepdims=True), 1), u)


def _on_axis(sphere: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    return np.hypot(sphere[:, 0], sphere[:, 1]) < _POLE


def _with_pole(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    pole: float,
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"], Int[np.ndarray, "q 3"]]:
    """The triangulation with the pole (0, 0, ±1) as a vertex."""
    if (_on_axis(sphere) & (sphere[:, 2] * pole > 0)).any():
        return surface, sphere, faces
    n = len(sphere)
    sphere = np.concatenate([sphere, [[0.0, 0.0, pole]]])
    a, b, c = faces.T
    top = np.full(len(faces), n)
    around = [np.stack(corners, axis=1) for corners in ((a, b, top), (b, c, top), (c, a, top))]
    own = spherical_orientation(sphere, faces)
    signs = np.stack([spherical_orientation(sphere, part) * own for part in around], axis=1)
    inside = (signs >= 0).all(axis=1) & (own != 0)
    hit = np.flatnonzero(inside)
    if len(hit) == 0:
        return surface, sphere[:n], faces
    # On an edge the pole lies in both of its triangles, and the part along the edge has no area.
    pieces = np.concatenate([part[inside & (signs[:, k] > 0)] for k, part in enumerate(around)])
    place = _preimage(surface, sphere, faces[hit[0]])
    return (
        np.concatenate([surface, place[None]]),
        sphere,
        np.concatenate([faces[~inside], pieces]).astype(np.int64),
    )


def _preimage(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "k 3"],
    face: Int[np.ndarray, " 3"],
) -> Float[np.ndarray, " 3"]:
    """The point of a surface triangle that the last of the sphere's positions comes from."""
    corners, top = sphere[face], sphere[-1]
    opposite = np.cross(corners[[1, 2, 0]], corners[[2, 0, 1]])
    weights = np.abs(opposite @ top)
    place: np.ndarray = weights @ surface[face] / weights.sum()
    return place
