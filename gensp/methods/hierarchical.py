"""Per-shape methods on the hierarchical embedding: every genus-0 mesh gets a bijective map."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from gensp.geometry.alignment import normal_rotation
from gensp.geometry.embedding import Schedule, embed
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.multifrontal import MultifrontalCholesky
from gensp.geometry.newton import Refined, minimise_map, refine_map
from gensp.geometry.operators import cotangent_laplacian
from gensp.geometry.predicates import bad_faces
from gensp.geometry.smat_energy import SmatEnergy
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_energy import triangle_weights
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.outcome import certified
from gensp.methods.refinement import HIERARCHICAL

Newton = Callable[[Mesh, Float[np.ndarray, "n 3"]], Refined]


@dataclass(frozen=True)
class NewtonPolish:
    """Projected Newton on one map: energy, triangle weights, when to stop.

    Attributes
    ----------
    energy
        Of `compiled.energies.ENERGIES`.
    floor
        Of `spherical_energy.triangle_weights`.
    max_iterations, tolerance, detour
        Of `newton.refine_map`.
    """

    energy: str = "dirichlet"
    floor: float = 1.0
    max_iterations: int = 150
    tolerance: float = 1e-4
    detour: bool = False

    def __call__(self, mesh: Mesh, start: Float[np.ndarray, "n 3"]) -> Refined:
        """The refined map of a mesh at area 4π."""
        return refine_map(
            mesh,
            start,
            weights=triangle_weights(mesh, self.floor),
            energy=self.energy,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            detour=self.detour,
        )


@dataclass(frozen=True)
class BySize:
    """One polish for maps of few vertices, another from `size` vertices on."""

    few: Newton
    many: Newton
    size: int = 10_000

    def __call__(self, mesh: Mesh, start: Float[np.ndarray, "n 3"]) -> Refined:
        """The refined map of a mesh."""
        return (self.few if len(mesh.vertices) < self.size else self.many)(mesh, start)


@dataclass(frozen=True)
class SmatPolish:
    """Projected Newton on the energy of Schmidt et al. 2023.

    Attributes
    ----------
    few, many
        Newton steps at most below and above `size` vertices.
    size
        Number of vertices that tells few from many.
    decrement
        Of `newton.minimise_map`.
    barrier, angle, area
        Of `smat_energy.SmatEnergy`.
    """

    few: int = 20
    many: int = 10
    size: int = 1000
    decrement: float = 10.0
    barrier: float = 1.0
    angle: float = 100.0
    area: float = 1.0

    def __call__(self, mesh: Mesh, start: Float[np.ndarray, "n 3"]) -> Refined:
        """The refined map of a mesh."""
        return minimise_map(
            mesh,
            start,
            SmatEnergy(mesh, barrier=self.barrier, angle=self.angle, area=self.area),
            max_iterations=self.few if len(mesh.vertices) < self.size else self.many,
            tolerance=0.0,
            decrement=self.decrement,
        )


@dataclass(frozen=True)
class Hierarchical:
    """Coarse to fine from a tetrahedron, and Newton on the way and at the end.

    Attributes
    ----------
    name
        What the method is called: by its energies and schedule it is one of several.
    schedule
        Energy and relaxations of the growing map.
    coarse, fine
        Newton on the growing map at the schedule's sizes, and on the whole; none: left out.
    """

    name: str = "dirichlet"
    schedule: Schedule = field(default_factory=Schedule)
    coarse: Newton | None = None
    fine: Newton | None = None

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh, turned so that points of the sphere agree with surface normals.

        Raises
        ------
        NotEmbeddable
            The mesh has no map in double precision; the message names the place.
        """
        began = time.perf_counter()
        shape = normalize(mesh)
        u = embed(shape, schedule=self.schedule, polish=self._coarse if self.coarse else None)
        embedded = time.perf_counter()
        u, counted = self._refined(shape, u)
        u = _turned(u, shape)
        ended = time.perf_counter()
        numbers = {
            "rung": HIERARCHICAL,
            **counted,
            "seconds_embed": embedded - began,
            "seconds_refine": ended - embedded,
            "seconds": ended - began,
        }
        return certified(mesh, u, numbers)

    def _refined(
        self, mesh: Mesh, u: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], dict[str, Any]]:
        """The map after the last Newton iteration, and how that ended; as it is without one."""
        if self.fine is None:
            return u, {}
        refined = self.fine(mesh, u)
        return refined.sphere, {
            "iterations": refined.iterations,
            "converged": refined.converged,
        }

    def _coarse(
        self, mesh: Mesh, u: Float[np.ndarray, "n 3"], vertices: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        assert self.coarse is not None
        return self.coarse(mesh, u).sphere


def _turned(u: Float[np.ndarray, "n 3"], mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """Turned to the surface's normals, unless rounding would fold a face that is sound now."""
    turned = u @ normal_rotation(u, mesh).T
    return u if bad_faces(turned, mesh.faces).any() else turned


def dirichlet(
    *, energy: str = "sigma", floor: float = 3.0, tolerance: float = 3e-4
) -> Hierarchical:
    """Ours: the symmetric Dirichlet energy while the map grows, then one that is what is reported.

    Of large meshes Newton on the growing map has the last energy already, so that few steps are
    left at the end. While a map has few vertices this energy would let limbs settle worse.

    Parameters
    ----------
    energy, floor, tolerance
        Of the last Newton iteration. `energy="dirichlet"` ends where it began.
    """
    return Hierarchical(
        name="dirichlet",
        schedule=Schedule(energy="dirichlet", floor=1.0),
        coarse=BySize(
            few=NewtonPolish(energy="dirichlet", max_iterations=30, tolerance=1e-3),
            many=NewtonPolish(energy=energy, floor=floor, max_iterations=30, tolerance=1e-3),
        ),
        fine=NewtonPolish(energy=energy, floor=floor, tolerance=tolerance, detour=True),
    )


def stretch() -> Hierarchical:
    """L² stretch, vertex by vertex, on a slowly growing map (Praun & Hoppe 2003).

    Ours are the order of the collapses and Newton's method where they search along lines.
    """
    return Hierarchical(
        name="stretch",
        schedule=Schedule(energy="stretch", floor=0.0, growth=1.2, passes=3, polish=(), last=30),
    )


def ahsp(*, bound: float = 2.0) -> Hierarchical:
    """Flat regions first, flexible groups, exponential isometric energy (Hu, Fu & Liu 2017).

    Parameters
    ----------
    bound
        Largest σ_t wished for: it ends a group of new vertices, and calls for a relaxation of the
        whole map.
    """
    return Hierarchical(
        name="ahsp",
        schedule=Schedule(
            energy="amips", floor=1e6, growth=2.0, passes=5, polish=(), last=100, bound=bound
        ),
    )


def smat(*, barrier: float = 1.0, angle: float = 100.0, area: float = 1.0) -> Hierarchical:
    """Barrier, angles and areas by Newton on every level (Schmidt et al. 2023).

    Energy, order of the collapses, independent sets and Newton's schedule are the authors'. Ours
    is what happens within a set. They move each new vertex by this energy, from the best of 250
    places; here it enters in the middle of its ring's kernel and is relaxed, with its ring, by the
    symmetric Dirichlet energy over all triangles alike, which is compiled already and sees both
    terms; Newton on all vertices follows at once and decides.

    Parameters
    ----------
    barrier, angle, area
        Weights of the energy. Where these fail, the authors' program begins anew with a barrier of
        1000, and then without angles and areas.
    """
    polish = SmatPolish(barrier=barrier, angle=angle, area=area)
    return Hierarchical(
        name="smat",
        schedule=Schedule(
            energy="dirichlet", floor=1e6, passes=1, polish="sets", last=1, priority="smat"
        ),
        coarse=polish,
        fine=replace(polish, few=50, many=50),
    )


def compile_loops() -> float:
    """Compile the inner loops, or load those kept on disk, once in a process.

    Whoever times a method calls it before, so that the seconds are the method's own.

    Returns
    -------
    float
        Seconds that it took; next to none after the first call.
    """
    began = time.perf_counter()
    _map_something_small()
    return time.perf_counter() - began


@cache
def _map_something_small() -> None:
    ball = icosphere(1)
    dirichlet()(ball)
    ahsp()(ball)  # groups of flexible size
    matrix = cotangent_laplacian(ball) + sp.eye(len(ball.vertices))
    MultifrontalCholesky(matrix.tocsc(), ball.vertices)  # of large maps only
