"""Random genus-0 meshes that are hard to map: slivers, area ratios, limbs that hang over."""

import numpy as np
from scipy.spatial.transform import Rotation

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, unit

FLIPS = SPLITS = INSERTED = 40
SLIVERS = 6  # pairs of needles, and a cap, each
_SHRINK = 16  # at most: area of a triangle over that of the one which is put into it


def slivers(seed: int, *, flat: float = 1e-6, ratio: float = 1e6, limbs: int = 3) -> Mesh:
    """A closed surface of about 260 vertices with random triangles, some of them nearly flat.

    Parameters
    ----------
    flat
        Height over longest side of the slivers, which are needles and caps. They are cut off the
        largest triangles, so that their areas are about this part of the largest.
    ratio
        Largest over smallest area of the other triangles; it is larger where chance made it so.
    limbs
        Arms that wind about the body, so that no point within sees the whole surface.
    """
    rng = np.random.default_rng(seed)
    surface = Triangles(winding(limbs, rng), rng)
    surface.flip(FLIPS)
    for _ in range(SPLITS):
        surface.split(surface.any(), 0.2 + 0.6 * rng.random(), rough=0.1)
    for _ in range(INSERTED):
        surface.insert(surface.any(), rng.dirichlet([4, 4, 4]), rough=0.1)
    surface.flip(FLIPS)
    surface.nest(ratio)
    needle, cap = np.array([1 - 2 * flat, flat, flat]), np.array([0.5, 0.5 - flat, flat])
    for weights in SLIVERS * [needle, cap]:
        surface.insert(surface.largest(), weights)
    return normalize(surface.mesh(f"seed {seed}"))


def winding(limbs: int, rng: np.random.Generator) -> Mesh:
    """A rough ball with arms, every shell turned further than the one below it."""
    ball = icosphere(2)
    feet = unit(rng.standard_normal((limbs, 3)))
    squared = np.sum((ball.vertices[:, None] - feet) ** 2, axis=2)
    length = 2.5 * np.exp(-squared / 0.15).max(axis=1, initial=0)
    radius = (1 + length) * np.exp(0.1 * rng.standard_normal(len(length)))
    # An axis across the first arm, which is bent the most.
    axis = unit(np.cross(feet[0] if limbs else rng.standard_normal(3), rng.standard_normal(3)))
    turns = Rotation.from_rotvec(np.maximum(radius - 1, 0)[:, None] * axis)
    return Mesh(turns.apply(ball.vertices * radius[:, None]), ball.faces)


class Triangles:
    """A closed oriented triangulation that is changed at random, and stays one."""

    def __init__(self, mesh: Mesh, rng: np.random.Generator) -> None:
        self.rng = rng
        self.vertices = list(mesh.vertices)
        self.faces = [tuple(face) for face in mesh.faces.tolist()]

    def mesh(self, name: str = "mesh") -> Mesh:
        """What it is now."""
        return Mesh(np.array(self.vertices), np.array(self.faces, dtype=np.int64), name)

    def any(self) -> int:
        """A random face."""
        return int(self.rng.integers(len(self.faces)))

    def largest(self) -> int:
        """The face of the largest area."""
        return int(np.argmax(self.mesh().face_areas))

    def flip(self, count: int) -> None:
        """Turn `count` random edges within their two triangles, where no edge is there twice."""
        while count:
            f, k = self.any(), int(self.rng.integers(3))
            a, b, c = self.faces[f][k:] + self.faces[f][:k]
            g, d = self._across(a, b)
            if not any({c, d} <= set(face) for face in self.faces):
                self.faces[f], self.faces[g] = (a, d, c), (d, b, c)
                count -= 1

    def split(self, f: int, share: float, rough: float = 0.0) -> None:
        """A vertex on the first edge of a face, at this share of it."""
        a, b, c = self.faces[f]
        g, d = self._across(a, b)
        p = self._add(f, np.array([1 - share, share, 0.0]), rough)
        self.faces[f], self.faces[g] = (a, p, c), (b, p, d)
        self.faces += [(p, b, c), (p, a, d)]

    def insert(self, f: int, weights: np.ndarray, rough: float = 0.0) -> None:
        """A vertex within a face."""
        a, b, c = self.faces[f]
        p = self._add(f, weights, rough)
        self.faces[f] = (a, b, p)
        self.faces += [(b, c, p), (c, a, p)]

    def nest(self, ratio: float) -> None:
        """Triangles within the smallest triangle until the largest is `ratio` times as large."""
        areas = self.mesh().face_areas
        f, needed = int(np.argmin(areas)), areas.min() * ratio / areas.max()
        steps = int(np.ceil(np.log(needed) / np.log(_SHRINK))) if needed > 2 else 0
        for _ in range(steps):
            size = needed ** (-0.5 / steps)
            (a, b, c), middle = self.faces[f], (1 - size) / 3
            p, q, r = (self._add(f, middle + size * corner) for corner in np.eye(3))
            self.faces[f] = (p, q, r)
            self.faces += [(a, b, p), (b, q, p), (b, c, q), (c, r, q), (c, a, r), (a, p, r)]

    def _across(self, a: int, b: int) -> tuple[int, int]:
        """The face with the edge from b to a, and its third vertex."""
        for g, face in enumerate(self.faces):
            for k in range(3):
                if face[k] == b and face[(k + 1) % 3] == a:
                    return g, face[(k + 2) % 3]
        raise AssertionError("the triangulation is open")

    def _add(self, f: int, weights: np.ndarray, rough: float = 0.0) -> int:
        corners = np.array([self.vertices[v] for v in self.faces[f]])
        side = np.linalg.norm(corners[1] - corners[0])
        noise = rough * side * self.rng.standard_normal(3)
        self.vertices.append(weights @ corners + noise)
        return len(self.vertices) - 1
