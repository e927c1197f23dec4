"""Texture coordinates of a spherical map in one rectangular picture, with sound seam and poles.

A picture of longitudes and latitudes has a seam, where u jumps from 1 to 0, and two poles, where
u means nothing. Triangles across the seam get copies of their vertices with u + 1 (the picture
repeats), every triangle at a pole its own copy of the pole's vertex, and a pole that lies within a
triangle becomes a vertex. A triangle without a pole inside spans less than half of the longitudes,
so no triangle of the result runs across the picture. Around the poles, where longitudes are far
from linear on a triangle, edges are halved.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import spherical_orientation
from gensp.geometry.sphere import unit

_WIDEST = 1 / 24  # of the picture: an edge that spans more longitudes is halved
_HALVINGS = 5
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
        Triangles (q, 3): those of the map, split around the poles.
    source
        Vertex of the map (k,) that each is a copy of; inserted ones come after all others.
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
    for _ in range(_HALVINGS):
        surface, sphere, faces = _halved(surface, sphere, faces)
    sphere = unit(sphere)
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


def _halved(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"], Int[np.ndarray, "q 3"]]:
    """The same map with a vertex in the middle of every edge that spans too many longitudes."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    key = sides[..., 0] * len(sphere) + sides[..., 1]
    unique, edge = np.unique(key, return_inverse=True)
    a, b = np.divmod(unique, len(sphere))
    u = equirectangular(sphere)[:, 0]
    span = np.abs(u[a] - u[b] - np.rint(u[a] - u[b]))
    wide = (span > _WIDEST) & ~_on_axis(sphere)[a] & ~_on_axis(sphere)[b]
    middle = np.where(wide, len(sphere) + np.cumsum(wide) - 1, -1)[edge.reshape(-1, 3)]
    a, b = a[wide], b[wide]
    # The map is linear on chords, so the middles stay within the sphere until the end.
    return (
        np.concatenate([surface, (surface[a] + surface[b]) / 2]),
        np.concatenate([sphere, (sphere[a] + sphere[b]) / 2]),
        split_at_middles(faces, middle),
    )


def split_at_middles(
    faces: Int[np.ndarray, "m 3"], middle: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, "q 3"]:
    """Triangles split at given vertices in the middle of their sides, −1 where there is none.

    Side k of a triangle joins its corners k and k + 1.
    """
    count = (middle >= 0).sum(axis=1)
    # Turned so that a single middle lies on the first side, a single whole side is the last.
    first = np.where(count == 2, (middle < 0).argmax(axis=1) + 1, (middle >= 0).argmax(axis=1))
    turn = (first[:, None] + np.arange(3)) % 3
    faces = np.take_along_axis(faces, turn, axis=1)
    middle = np.take_along_axis(middle, turn, axis=1)
    a, b, c, p, q, r = np.concatenate([faces, middle], axis=1).T
    parts = {
        0: [(a, b, c)],
        1: [(a, p, c), (p, b, c)],
        2: [(p, b, q), (a, p, q), (a, q, c)],
        3: [(a, p, r), (p, b, q), (r, q, c), (p, q, r)],
    }
    pieces = [np.stack(t, 1)[count == n] for n, split in parts.items() for t in split]
    return np.concatenate(pieces).astype(np.int64)


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
