"""Which triangle every pixel shows, by a z-buffer in plain numpy.

Triangles are expanded into the pixels of their bounding boxes, all at once; no loop goes over
triangles or pixels.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

CANDIDATES = 1_000_000
HALF, ROUNDING = np.float32(0.5), np.float32(1e-5)


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
    a = corners[:, 0, :2]
    first, second = corners[:, 1, :2] - a, corners[:, 2, :2] - a
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
