"""Hierarchical spherical embedding: from a tetrahedron to the whole surface, without a fold.

A surface is collapsed to a tetrahedron, the tetrahedron is put on the sphere, and the vertices
come back one by one, each into the kernel of its ring, so that every map on the way is bijective
(Praun & Hoppe 2003; Hu, Fu & Liu 2017; Schmidt et al. 2023). Vertices are relaxed as they come;
whenever the map has grown enough it is relaxed as a whole.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from gensp.compiled.collapses import BASE
from gensp.compiled.energies import ENERGIES
from gensp.compiled.growth import insert, largest_distortion, sweep
from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import best_rotation
from gensp.geometry.decimation import Collapses, Priority, decimate
from gensp.geometry.mesh import SPHERE_AREA, Mesh
from gensp.geometry.predicates import bad_faces, spherical_orientation
from gensp.geometry.progress import tell
from gensp.geometry.sphere import unit

_TETRAHEDRON = unit(np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]))
_STILL = 1e-3  # of the mean edge: vertices that their ring moved by less are not visited
_WORTH = 0.7  # of the vertices: a polish later than that is left to the whole map
_FEW, _FEW_PASSES = 300, 4  # vertices of a map that is relaxed more often, times
_GROUP = 1.05  # growth of the map by the smallest group of new vertices
_STEPS = 2  # Newton steps of a vertex on each visit

Polish = Callable[
    [Mesh, Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]], Float[np.ndarray, "n 3"]
]


@dataclass(frozen=True)
class Schedule:
    """How an embedding is relaxed while it grows.

    Attributes
    ----------
    energy
        Of `energies.ENERGIES`.
    floor
        Triangles smaller than this part of the mean area weigh as much as that; large values weigh
        all triangles alike.
    growth
        The whole map is relaxed whenever it has this many times the vertices, at the latest.
    passes
        Passes over all vertices at each such time.
    polish
        Sizes (in vertices) at which `embed`'s polish is called on the coarse map; `"sets"`: after
        every independent set of the collapses, however late.
    last
        Passes over the whole map at the end.
    priority
        Order of the collapses, see `decimation`.
    bound
        Largest σ_t wished for, as the energies see it (`stars.star_distortion`). A group of new
        vertices ends with the first that has a worse triangle, though not before the map has grown
        by 5 %; where one is left after the group and what it moved are relaxed, the whole map is.
        Infinite: groups are of fixed growth.
    """

    energy: str = "dirichlet"
    floor: float = 0.3
    growth: float = 1.4
    passes: int = 3
    polish: tuple[int, ...] | Literal["sets"] = (400, 3000, 20_000)
    last: int = 3
    priority: Priority = "quadric"
    bound: float = np.inf


def embed(
    mesh: Mesh,
    *,
    schedule: Schedule | None = None,
    target: Float[np.ndarray, "n 3"] | None = None,
    pull: Float[np.ndarray, " n"] | float = 0.0,
    polish: Polish | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Unit positions (n, 3) of a bijective map of a closed genus-0 mesh at area 4π.

    Parameters
    ----------
    target, pull
        Unit positions and weights γ_i ≥ 0 of Σ γ_i M_i ‖u_i − target_i‖², which guides every
        insertion and relaxation; vertices of weight zero go where the energy sends them.
    polish
        Called with a coarse mesh, its map, and the indices of its vertices in `mesh`; gives the
        improved map, free of bad faces.

    Raises
    ------
    NotEmbeddable
        A vertex has no place in double precision; the message names it.
    """
    schedule = schedule or Schedule()
    mesh = _in_rows(mesh)
    goals = np.zeros_like(mesh.vertices) if target is None else unit(target)
    pulls = np.zeros(len(mesh.vertices)) if target is None else np.broadcast_to(pull, len(goals))
    tell("collapsing the mesh")
    collapses = decimate(mesh, schedule.priority)
    growing = _Growing(mesh, collapses, schedule, goals, np.ascontiguousarray(pulls, float))
    whole = len(mesh.vertices)
    for size in [*(_sizes(schedule, collapses, whole) if polish else []), whole]:
        while growing.count < size:
            growing.grow(size)
            tell(f"growing the map: {growing.count} of {whole} vertices")
        if polish is not None and size < whole:
            growing.improve(polish)
    return growing.finished()


def _in_rows(mesh: Mesh) -> Mesh:
    """The mesh with arrays row by row: for another order the loops would be compiled again."""
    rows = np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    return replace(mesh, vertices=rows[0], faces=rows[1])


def _sizes(schedule: Schedule, collapses: Collapses, whole: int) -> list[int]:
    """Numbers of vertices at which a coarse map is polished."""
    if schedule.polish == "sets":
        return [size for size in collapses.sizes if BASE < size < whole]
    return [size for size in schedule.polish if BASE < size < _WORTH * whole]


class _Growing:
    """A map that grows from the tetrahedron."""

    def __init__(
        self,
        mesh: Mesh,
        collapses: Collapses,
        schedule: Schedule,
        goals: Float[np.ndarray, "n 3"],
        pulls: Float[np.ndarray, " n"],
    ) -> None:
        self.mesh, self.schedule, self.goals, self.pulls = mesh, schedule, goals, pulls
        self.halfedges, self.base = collapses.halfedges, collapses.base
        self.order = np.ascontiguousarray(collapses.order[::-1])
        self.inserted = 0
        count = len(mesh.vertices)
        self.moved, self.waits = np.zeros(count), np.zeros(count, np.int64)
        self.work = (np.empty(count, np.int64), np.empty(count, np.int64), np.empty((count, 8)))
        self.u = np.zeros((count, 3))
        self.u[self.base] = self._tetrahedron()

    @property
    def count(self) -> int:
        """Vertices on the sphere so far."""
        return BASE + self.inserted

    @property
    def whole(self) -> bool:
        """Whether every vertex is on the sphere."""
        return self.inserted == len(self.order)

    def faces(self) -> Int[np.ndarray, "m 3"]:
        """Triangles of the map so far."""
        alive = np.ones(len(self.mesh.faces), dtype=bool)
        gone = self.order[self.inserted :]
        alive[gone // 3] = alive[self.halfedges.twin[gone] // 3] = False
        return self.halfedges.origin.reshape(-1, 3)[alive]

    def grow(self, limit: int) -> None:
        """Insert a group of vertices, until there are `limit` at most, and relax."""
        fewest, most = (
            min(limit, int(np.ceil(self.count * growth)))
            for growth in (_GROUP, self.schedule.growth)
        )
        group = (self.inserted, most - BASE, fewest - BASE, float(self.schedule.bound))
        self.inserted, placed = insert(
            self.order, *group, *self._arrays(), *self._settings(), self.waits, *self.work
        )
        if not placed:
            self._fail()
        self._relax()

    def improve(self, polish: Polish) -> None:
        """Hand the coarse map to `polish`."""
        faces = self.faces()
        used = np.unique(faces)
        place = np.full(len(self.mesh.vertices), -1)
        place[used] = np.arange(len(used))
        coarse = Mesh(self.mesh.vertices[used], place[faces], self.mesh.name)
        grown = np.sqrt(SPHERE_AREA / coarse.area)
        coarse = replace(coarse, vertices=coarse.vertices * grown)
        self.u[used] = polish(coarse, self.u[used], used)

    def finished(self) -> Float[np.ndarray, "n 3"]:
        """The map of the whole mesh."""
        bad = bad_faces(self.u, self.mesh.faces)
        if bad.any():
            raise NotEmbeddable(
                f"{self.mesh.name}: {int(bad.sum())} faces (first: {int(np.argmax(bad))}) have no "
                "area on the sphere in double precision; remesh the surface there"
            )
        return self.u

    def _tetrahedron(self) -> Float[np.ndarray, "4 3"]:
        """A regular tetrahedron for the base, turned the right way round and to its goals."""
        place = {int(v): k for k, v in enumerate(self.base)}
        faces = np.array([[place[int(v)] for v in face] for face in self.faces()])
        corners = _TETRAHEDRON.copy()
        if spherical_orientation(corners, faces)[0] < 0:
            corners = corners[[1, 0, 2, 3]]
        weights = self.pulls[self.base]
        if weights.sum() > 0:
            corners = corners @ best_rotation(corners, self.goals[self.base], weights).T
        return corners

    def _arrays(self) -> tuple[np.ndarray, ...]:
        edges = self.halfedges
        return (self.mesh.vertices, self.u, edges.origin, edges.twin, edges.leaving, self.moved)

    def _settings(self) -> tuple:
        faces = self.faces()
        scale = SPHERE_AREA / Mesh(self.mesh.vertices, faces).area
        least = self.schedule.floor * SPHERE_AREA / len(faces)
        share = SPHERE_AREA / self.count
        return scale, least, ENERGIES[self.schedule.energy], self.pulls * share, self.goals

    def _relax(self) -> None:
        passes = self.schedule.passes * (_FEW_PASSES if self.count < _FEW else 1)
        active = np.unique(self.faces())
        self._sweep(active, self.schedule.last if self.whole else passes)
        if self.whole or np.isinf(self.schedule.bound):
            return
        if self._distortion(active) > self.schedule.bound:
            self.moved[active] = 1.0
            self._sweep(active, passes)

    def _sweep(self, active: Int[np.ndarray, " k"], passes: int) -> None:
        still = _STILL * np.sqrt(SPHERE_AREA / self.count)
        settings = self._settings()
        for _ in range(passes):
            sweep(active, still, _STEPS, *self._arrays(), *settings, *self.work)

    def _distortion(self, active: Int[np.ndarray, " k"]) -> float:
        """Largest σ_t of the map so far."""
        *arrays, _ = self._arrays()
        scale, least, *_ = self._settings()
        around, _, star = self.work
        return largest_distortion(active, *arrays, scale, least, around, star)

    def _fail(self) -> None:
        h = int(self.order[self.inserted])
        vertex = int(self.halfedges.origin[h])
        raise NotEmbeddable(
            f"{self.mesh.name}: vertex {vertex} finds no place on the sphere in double precision "
            f"(after {self.count} of {len(self.mesh.vertices)} vertices); remesh the surface near "
            f"{np.round(self.mesh.vertices[vertex], 4).tolist()}"
        )
