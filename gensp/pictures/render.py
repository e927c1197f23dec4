"""Shaded pictures of triangle meshes, in plain numpy: the same on every machine.

Every pixel finds its triangle by a z-buffer and interpolates what the vertices carry, so that a
texture is evaluated once per pixel and stays crisp on a coarse mesh. No OpenGL is needed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import unit
from gensp.pictures.rasterize import Fragments, rasterize
from gensp.pictures.texture import sphere_texture, to_bytes

SUPERSAMPLING = 2
MARGIN = 0.06
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

    def by_point(
        self, colour: Callable[[Float[np.ndarray, "q 3"]], Float[np.ndarray, "q 3"]]
    ) -> UInt8[np.ndarray, "size size 3"]:
        """With a colour for every visible point of the surface."""
        return self._picture(
            colour(self.fragments.interpolate(self.mesh.vertices, self.mesh.faces))
        )

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
