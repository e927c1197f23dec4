"""Shaded pictures of triangle meshes, in plain numpy: the same on every machine.

Every pixel finds its triangle by a z-buffer and interpolates what the vertices carry, so that a
texture is evaluated once per pixel and stays crisp on a coarse mesh. No OpenGL is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.ndimage import gaussian_filter

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import unit
from gensp.pictures.texture import sphere_texture, to_bytes

SUPERSAMPLING = 2
MARGIN = 0.06
CANDIDATES = 1_000_000
HALF, ROUNDING = np.float32(0.5), np.float32(1e-5)
# Direction to each light in the camera's frame (right, up, towards the eye), and its strength.
LIGHTS = ((-0.45, 0.65, 0.75, 0.62), (0.8, 0.1, 0.45, 0.22))
AMBIENT, SKY, SHINE = 0.36, 0.12, 0.10
UP_AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@dataclass(frozen=True)
class View:
    """An orthographic camera: rotation (rows right, up, towards the eye), centre and half-width.

    `extent` is half the side of the square that the picture shows.
    """

    rotation: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, " 3"]
    extent: float

    def fitted(self, *points: Float[np.ndarray, "_ 3"]) -> "View":
        """The same direction with all points in the frame, a margin around them."""
        seen = np.concatenate(points) @ self.rotation.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        extent = float((high - low)[:2].max() / 2 / (1 - 2 * MARGIN))
        return replace(self, centre=self.rotation.T @ ((low + high) / 2), extent=extent)

    def project(self, vertices: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Camera coordinates: x and y in [−1, 1] within the frame, z towards the eye."""
        return (vertices - self.centre) @ self.rotation.T / self.extent


def up_axis(up: str) -> Float[np.ndarray, " 3"]:
    """The unit vector of x, y or z, reversed by a minus sign."""
    return np.array(UP_AXES[up[-1]], dtype=float) * (-1 if up.startswith("-") else 1)


def look(up: str = "y", azimuth: float = 30, elevation: float = 15) -> View:
    """A three-quarter view: degrees around the up axis and above the ground.

    `up` is x, y or z, with a minus sign for a collection that stands on its head. Azimuth 0 looks
    at the front, which is +z for y up and the next axis in turn for the others.
    """
    axis = up_axis(up)
    front = np.roll(np.abs(axis), 1)
    right = np.cross(axis, front)
    a, e = np.radians(azimuth), np.radians(elevation)
    level = np.cos(a) * front + np.sin(a) * right
    eye = np.cos(e) * level + np.sin(e) * axis
    side = unit(np.cross(axis, eye))
    return View(np.stack([side, np.cross(eye, side), eye]), np.zeros(3), 1.0)


@dataclass(frozen=True)
class Fragments:
    """What each covered pixel of an h×w picture shows: triangle, barycentric weights, depth."""

    pixel: Int[np.ndarray, " q"]
    face: Int[np.ndarray, " q"]
    barycentric: Float[np.ndarray, "q 3"]
    depth: Float[np.ndarray, " q"]

    def interpolate(
        self, values: Float[np.ndarray, "n c"], faces: Int[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "q c"]:
        """Values at the vertices, carried to the pixels."""
        corners = faces[self.face]
        return sum(self.barycentric[:, j, None] * values[corners[:, j]] for j in range(3))


def rasterize(
    projected: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    size: int,
    *,
    closed: bool = False,
) -> Fragments:
    """The nearest triangle at every pixel centre of a size×size picture.

    Triangles that look away from the eye are left out if the surface is `closed`. Triangles are
    expanded into the pixels of their bounding boxes, in bounded portions.
    """
    screen = np.stack(
        [(projected[:, 0] + 1) * size / 2, (1 - projected[:, 1]) * size / 2, projected[:, 2]], 1
    )
    nearest = np.full(size * size, -np.inf, dtype=np.float32)
    parts = []
    for part in _portions(screen, faces, size, closed):
        closer = part.depth > nearest[part.pixel]
        order = np.argsort(part.depth[closer], kind="stable")
        chosen = np.flatnonzero(closer)[order]
        # Of several fragments in one pixel the last in the order, the closest, is kept.
        winner = np.full(size * size, -1)
        winner[part.pixel[chosen]] = chosen
        kept = winner[winner >= 0]
        nearest[part.pixel[kept]] = part.depth[kept]
        parts.append(_taken(part, kept))
    joined = Fragments(*(np.concatenate([_fields(p)[k] for p in parts]) for k in range(4)))
    return _taken(joined, np.flatnonzero(joined.depth == nearest[joined.pixel]))


def _fields(fragments: Fragments) -> tuple[np.ndarray, ...]:
    return fragments.pixel, fragments.face, fragments.barycentric, fragments.depth


def _taken(fragments: Fragments, index: np.ndarray) -> Fragments:
    return Fragments(*(field[index] for field in _fields(fragments)))


def _portions(
    screen: np.ndarray, faces: np.ndarray, size: int, closed: bool
) -> Iterator[Fragments]:
    # Single precision is a ten-thousandth of a pixel, and half the memory traffic.
    corners = screen[faces].astype(np.float32)
    # Pixel centres lie at half-integers: box of integers i with low ≤ i + 1/2 ≤ high.
    a, b, c = (corners[:, j, :2] for j in range(3))
    smallest, largest = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    low = np.clip(np.ceil(smallest - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(largest + 0.5), 0, size).astype(np.int64)
    box = np.maximum(high - low, 0)
    count = box[:, 0] * box[:, 1]
    if closed:
        # Rows run downwards, so a triangle that faces the eye turns clockwise on the screen.
        (ux, uy), (vx, vy) = (b - a).T, (c - a).T
        count[ux * vy - uy * vx >= 0] = 0
    portion = np.cumsum(count) // CANDIDATES
    for index in range(int(portion[-1]) + 1 if len(count) else 0):
        chosen = np.flatnonzero((portion == index) & (count > 0))
        yield _covered(corners, chosen, low, box, count, size)


def _covered(
    corners: np.ndarray,
    chosen: np.ndarray,
    low: np.ndarray,
    box: np.ndarray,
    count: np.ndarray,
    size: int,
) -> Fragments:
    """The pixel centres inside the chosen triangles."""
    face = np.repeat(chosen, count[chosen])
    start = np.repeat(np.cumsum(count[chosen]) - count[chosen], count[chosen])
    row, column = np.divmod(np.arange(len(face)) - start, box[face, 0])
    x, y = column + low[face, 0], row + low[face, 1]
    weights = _barycentric(corners, face, x.astype(np.float32), y.astype(np.float32))
    inside = weights.min(axis=0) >= -ROUNDING
    weights = weights[:, inside].T
    face = face[inside]
    depth = np.einsum("qj,qj->q", weights, corners[face, :, 2])
    return Fragments(y[inside] * size + x[inside], face, weights, depth)


def _barycentric(
    corners: np.ndarray, face: np.ndarray, x: np.ndarray, y: np.ndarray
) -> Float[np.ndarray, "3 q"]:
    a, first, second = (
        corners[:, 0, :2],
        *np.moveaxis(corners[:, 1:, :2] - corners[:, :1, :2], 1, 0),
    )
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    inverse = np.divide(1, area, out=np.full_like(area, np.nan), where=area != 0)
    offset = a - HALF
    # Each weight is affine in the pixel: its gradient is found once per triangle.
    gradients = (
        np.stack([second[:, 1], -second[:, 0], -first[:, 1], first[:, 0]], axis=1)
        * inverse[:, None]
    )
    dx, dy, slope = x - offset[face, 0], y - offset[face, 1], gradients[face]
    beta = dx * slope[:, 0] + dy * slope[:, 1]
    gamma = dx * slope[:, 2] + dy * slope[:, 3]
    return np.stack([1 - beta - gamma, beta, gamma])


class Scene:
    """One mesh seen by one camera, to be painted in several ways: the visible pixels are kept.

    Parameters
    ----------
    mesh
        The triangles to draw; folded and inverted ones are drawn too, unless `closed`.
    view
        The camera, see `look` and `View.fitted`.
    size
        Side of the picture in pixels.
    closed
        The surface is closed and looks outwards, so that its far side needs no drawing.
    """

    def __init__(self, mesh: Mesh, view: View, size: int, *, closed: bool = False) -> None:
        self.mesh, self.size, self._fine = mesh, size, size * SUPERSAMPLING
        projected = view.project(mesh.vertices)
        self.fragments = rasterize(projected, mesh.faces, self._fine, closed=closed)
        turned = mesh.vertex_normals @ view.rotation.T
        normals = unit(self.fragments.interpolate(turned, mesh.faces))
        light, self._shine = _light(normals)
        self._light = light * _cavities(self.fragments, self._fine)

    def textured(self, sphere: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "size size 3"]:
        """Wearing the sphere's texture, through the vertices' positions on the sphere."""
        p = self.fragments.interpolate(sphere, self.mesh.faces)
        return self._picture(sphere_texture(unit(p)))

    def by_vertex(self, colours: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "size size 3"]:
        """With colours given at the vertices."""
        return self._picture(self.fragments.interpolate(colours, self.mesh.faces))

    def by_face(self, colours: Float[np.ndarray, "m 3"]) -> UInt8[np.ndarray, "size size 3"]:
        """With one colour for every triangle."""
        return self._picture(colours[self.fragments.face])

    def _picture(self, colours: Float[np.ndarray, "q 3"]) -> UInt8[np.ndarray, "size size 3"]:
        fine = np.ones((self._fine**2, 3))
        lit = colours * self._light[:, None] + self._shine[:, None]
        fine[self.fragments.pixel] = np.clip(lit, 0, 1)
        blocks = fine.reshape(self.size, SUPERSAMPLING, self.size, SUPERSAMPLING, 3)
        return to_bytes(blocks.mean(axis=(1, 3)))


def _light(normals: Float[np.ndarray, "q 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse light (Lambert, more from above than from below) and Blinn's highlights."""
    # A surface seen from its back is lit as if it faced the eye.
    facing = np.where(normals[:, 2:] < 0, -normals, normals)
    light = AMBIENT + SKY * (1 + facing[:, 1])
    shine = np.zeros(len(facing))
    for *direction, strength in LIGHTS:
        towards = unit(np.array(direction))
        light += strength * np.maximum(facing @ towards, 0)
        half_way = unit(towards + np.array([0, 0, 1.0]))
        shine += SHINE * strength * np.maximum(facing @ half_way, 0) ** 40
    return light, shine


def _cavities(fragments: Fragments, size: int) -> Float[np.ndarray, " q"]:
    """Darkening where the surroundings are nearer to the eye than the pixel.

    Source: Luft, Colditz, Deussen, Image enhancement by unsharp masking the depth buffer, 2006.
    """
    image = np.zeros((2, size * size))
    image[0, fragments.pixel], image[1, fragments.pixel] = fragments.depth, 1
    # The blur is wide, so a quarter of the pixels is enough for it.
    coarse = image.reshape(2, size, size)[:, ::2, ::2]
    depth, cover = (gaussian_filter(layer, size / 100, truncate=3) for layer in coarse)
    row, column = np.divmod(fragments.pixel, size)
    around = (depth / np.maximum(cover, 1e-9))[row // 2, column // 2]
    return 1 - np.clip(1.6 * (around - fragments.depth), 0, 0.45)
