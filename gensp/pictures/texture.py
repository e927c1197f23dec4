"""One texture on the sphere, without seam or poles: the same on every shape shows consistency.

The cells are those of an icosphere's vertices: twelve pentagons among hexagons of nearly one
size, so a stretched or starved region is seen by its cells, and every cell has its own colour.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import cKDTree

from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.texture_coordinates import equirectangular_directions

CELL_LEVEL = 3
LINE_WIDTH = 0.012
LINE_COLOUR = np.array([0.13, 0.13, 0.17])
# One colour for each end of each axis. The three differences between opposite ends are linearly
# independent, so no point of the sphere shares the colour of its antipode.
AXIS_COLOURS = np.array(
    [
        [[0.894, 0.341, 0.180], [0.060, 0.600, 0.710]],
        [[0.949, 0.757, 0.306], [0.239, 0.204, 0.545]],
        [[0.410, 0.690, 0.255], [0.784, 0.298, 0.620]],
    ]
)


def hue_field(p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """Smooth colours of sphere points: the axis colours mixed by the squared coordinates.

    The squares of a unit vector add up to one, so the mixture needs no normalisation and is
    continuously differentiable everywhere.
    """
    ends = (p < 0).astype(np.int64)
    colours = AXIS_COLOURS[np.arange(3), ends]
    return np.einsum("kj,kjc->kc", p**2, colours)


def sphere_texture(
    p: Float[np.ndarray, "k 3"], *, level: int = CELL_LEVEL, line_width: float = LINE_WIDTH
) -> Float[np.ndarray, "k 3"]:
    """Colours in [0, 1] of unit vectors: cells in the colour of their centre, dark borders.

    `line_width` is the width of a border in radians; pentagons are drawn lighter.
    """
    centres, colours, tree = _cells(level)
    _, nearest = tree.query(p, k=2)
    first = centres[nearest[:, 0]]
    difference = first - centres[nearest[:, 1]]
    to_border = np.einsum("kj,kj->k", p, difference)
    length = np.sqrt(np.einsum("kj,kj->k", difference, difference))
    border = to_border < line_width / 2 * length
    return np.where(border[:, None], LINE_COLOUR, colours[nearest[:, 0]])


@lru_cache(maxsize=4)
def _cells(level: int) -> tuple[np.ndarray, np.ndarray, cKDTree]:
    centres = icosphere(level).vertices
    colours = hue_field(centres)
    # The twelve vertices of the icosahedron come first.
    colours[:12] = 0.35 * colours[:12] + 0.65
    return centres, colours, cKDTree(centres)


def cube_map(size: int) -> UInt8[np.ndarray, "height size 3"]:
    """The texture on the six faces of a cube, one below the other: +x, −x, +y, −y, +z, −z.

    The layout of every face is that of OpenGL's cube maps (specification, section 8.13).
    """
    ticks = (2 * np.arange(size) + 1) / size - 1
    s, t = np.meshgrid(ticks, ticks)
    one = np.ones_like(s)
    faces = [
        (one, -t, -s),
        (-one, -t, s),
        (s, one, t),
        (s, -one, -t),
        (s, -t, one),
        (-s, -t, -one),
    ]
    p = unit(np.concatenate([np.stack(face, axis=-1) for face in faces]).reshape(-1, 3))
    return to_bytes(sphere_texture(p)).reshape(6 * size, size, 3)


def equirectangular_picture(height: int) -> UInt8[np.ndarray, "height width 3"]:
    """The texture by longitude and latitude, twice as wide as high, the pole +z on top."""
    p = equirectangular_directions(height)
    return to_bytes(sphere_texture(p.reshape(-1, 3))).reshape(p.shape)


def to_bytes(colours: Float[np.ndarray, "... c"]) -> UInt8[np.ndarray, "... c"]:
    """Colours in [0, 1] as bytes."""
    return np.round(255 * np.clip(colours, 0, 1)).astype(np.uint8)
