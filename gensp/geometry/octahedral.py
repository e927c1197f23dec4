"""The sphere as a square: the octahedral map, and geometry images made with it.

The octahedron |x| + |y| + |z| = 1 is projected along z: its upper half is the inner diamond of the
square [-1, 1]², its lower half is folded out to the corners. Sources: Praun & Hoppe 2003,
"Spherical parametrization and remeshing"; Meyer et al. 2010, "On floating-point normal vectors".
"""

import numpy as np
from jaxtyping import Float

from gensp.errors import Unsupported
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_map import SphericalMap

_SMALLEST, _LARGEST = 3, 4097


def octahedral_coordinates(p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """Place in the square [-1, 1]² of unit vectors; the pole +z is in the middle."""
    q = p / np.abs(p).sum(axis=1, keepdims=True)
    return np.where(q[:, 2:] < 0, _folded(q[:, :2]), q[:, :2])


def octahedral_directions(st: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 3"]:
    """Unit vectors of places in the square; the inverse of `octahedral_coordinates`."""
    z = 1 - np.abs(st).sum(axis=1, keepdims=True)
    return unit(np.concatenate([np.where(z < 0, _folded(st), st), z], axis=1))


def _folded(st: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    return (1 - np.abs(st[:, ::-1])) * np.where(st >= 0, 1, -1)


def octahedral_grid(size: int) -> Float[np.ndarray, "size size 3"]:
    """Unit vectors at the nodes of a size × size grid that covers the square, edges included.

    Row i and column j lie at s = -1 + 2j/(size - 1), t = 1 - 2i/(size - 1): the top row is t = 1.

    Raises
    ------
    Unsupported
        A size outside 3 … 4097.
    """
    if not _SMALLEST <= size <= _LARGEST:
        raise Unsupported(
            f"geometry image of {size} pixels a side; {_SMALLEST} to {_LARGEST} are possible; "
            "choose another size"
        )
    ticks = np.linspace(-1, 1, size)
    s, t = np.meshgrid(ticks, ticks[::-1])
    directions = octahedral_directions(np.stack([s, t], axis=-1).reshape(-1, 2))
    return directions.reshape(size, size, 3)


def geometry_image(map: SphericalMap, size: int) -> Float[np.ndarray, "size size 3"]:
    """Positions on the surface at the nodes of the octahedral grid.

    Nodes of the border that are one point of the sphere, mirrored in the middle of their side,
    have the same position, so the grid closes to a surface.
    """
    grid = octahedral_grid(size)
    return map.to_surface(grid.reshape(-1, 3)).reshape(size, size, 3)
