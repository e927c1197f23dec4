"""From a start on the sphere to the final map: as it is, or untangled and refined by Newton."""

import time
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from gensp.errors import NotEmbeddable
from gensp.geometry.embedding import embed
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import Refined, refine_map
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.refine import Untangled, shrinking, untangle
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_energy import triangle_weights
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.outcome import certified, finished

PREDICTION, SPREAD, UNTANGLED, HIERARCHICAL = "prediction", "spread", "untangled", "hierarchical"
# What became of the start, from the first rung of the ladder to the last.
RUNGS = {
    PREDICTION: "the start as it came",
    SPREAD: "its crowded faces spread",
    UNTANGLED: "its folds untangled",
    HIERARCHICAL: "embedded anew from a tetrahedron",
}


@dataclass(frozen=True)
class NoRefinement:
    """The start is the map; its folded faces are counted, not repaired."""

    def __call__(
        self,
        mesh: Mesh,
        start: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"] | None = None,
        trust: Float[np.ndarray, " n"] | None = None,
    ) -> SphericalMap:
        """The map of a mesh in its own coordinates at unit positions `start`."""
        u = unit(start)
        bad = int(bad_faces(u, mesh.faces).sum())
        numbers = {"seconds": 0.0, "rounds": 0, "iterations": 0, "bad_faces_start": bad}
        return finished(mesh, u, numbers)


@dataclass(frozen=True)
class NewtonRefinement:
    """Untangle the start, then minimise distortion without folding, pulled to the target.

    The ladder: the start if it has no folds, the untangled start, else the hierarchical embedding
    guided by the target, also where the start mirrors.

    Attributes
    ----------
    pull
        γ, how strongly the map is held at the target; nothing pulls where there is no target.
    energy
        Of `compiled.energies.ENERGIES`.
    floor
        Faces smaller than this part of the mean area weigh as much as that in the energy. Weighed
        by their true area, the smallest faces take the largest distortion; weighed all alike
        (a large floor), the map would follow the density of the mesh and lose consistency.
    max_iterations, tolerance
        Of Newton's method; where it does not converge by another energy than the symmetric
        Dirichlet energy, it begins again by way of that (`newton.refine_map`). A start from which
        it does not converge at all is left for the hierarchical embedding.
    crowding
        In a start without folds, faces that hold less than this part of their share of the sphere
        are spread out first.
    rings
        First widths of the untangled neighbourhoods, tried in turn until one leaves no fold.
    """

    pull: float = 30.0
    energy: str = "dirichlet"
    floor: float = 0.3
    max_iterations: int = 150
    tolerance: float = 1e-4
    crowding: float = 1e-2
    rings: tuple[int, ...] = (2, 4, 8, 1)

    def __call__(
        self,
        mesh: Mesh,
        start: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"] | None = None,
        trust: Float[np.ndarray, " n"] | None = None,
    ) -> SphericalMap:
        """The refined map of a mesh in its own coordinates, certified with degree 1.

        `trust` (n,) in [0, 1] tells how far the target holds at every vertex.

        Raises
        ------
        NotEmbeddable
            The mesh has no map in double precision; the message names the place.
        """
        began = time.perf_counter()
        shape, u = normalize(mesh), unit(start)
        bad = int(bad_faces(u, mesh.faces).sum())
        pull = 0.0 if target is None else self._pull(shape, target, trust)
        found, rung = self._start(mesh, u, target, pull, folded=bad > 0)
        refined = self._minimised(shape, found.sphere, target, pull)
        if not refined.converged and rung != HIERARCHICAL:
            refined, rung = self._otherwise(shape, refined, rung, target, pull)
        return certified(
            mesh,
            refined.sphere,
            {
                "rung": rung,
                "seconds": time.perf_counter() - began,
                "rounds": found.rounds,
                "iterations": refined.iterations,
                "converged": refined.converged,
                "bad_faces_start": bad,
            },
        )

    def _pull(
        self,
        mesh: Mesh,
        target: Float[np.ndarray, "n 3"],
        trust: Float[np.ndarray, " n"] | None,
    ) -> float | Float[np.ndarray, " n"]:
        """γ of the refinement: the same everywhere, however far the target is trusted."""
        return self.pull

    def _start(
        self,
        mesh: Mesh,
        u: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"] | None,
        pull: float | Float[np.ndarray, " n"],
        *,
        folded: bool,
    ) -> tuple[Untangled, str]:
        """A map without folds to refine, and the rung of the ladder that it stands on."""
        found = self._untangled(mesh, u, folded=folded)
        if found is None:
            grown = embed(normalize(mesh), target=target, pull=pull)
            return Untangled(grown, 0, True), HIERARCHICAL
        moved = UNTANGLED if folded else SPREAD
        return found, moved if found.rounds else PREDICTION

    def _otherwise(
        self,
        mesh: Mesh,
        refined: Refined,
        rung: str,
        target: Float[np.ndarray, "n 3"] | None,
        pull: float | Float[np.ndarray, " n"],
    ) -> tuple[Refined, str]:
        """The last rung for a map that did not converge, if it ends lower there."""
        # No face is folded, yet some are so nearly collapsed that no step gets anywhere.
        try:
            grown = embed(mesh, target=target, pull=pull)
            again = self._minimised(mesh, grown, target, pull)
        except NotEmbeddable:  # what there is has no fold, and its diagnostics say the rest
            return refined, rung
        return (again, HIERARCHICAL) if again.energy < refined.energy else (refined, rung)

    def _untangled(
        self, mesh: Mesh, u: Float[np.ndarray, "n 3"], *, folded: bool
    ) -> Untangled | None:
        """The start without folds and with degree 1, if untangling gets there."""
        areas = None if folded else mesh.face_areas
        for ring in self.rings:
            untangled = untangle(
                u, mesh.faces, areas=areas, crowding=self.crowding, first_ring=ring
            )
            if untangled.clean and map_degree(untangled.sphere, mesh.faces) == 1:
                return untangled
        return None

    def _minimised(
        self,
        mesh: Mesh,
        start: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"] | None,
        pull: float | Float[np.ndarray, " n"],
    ) -> Refined:
        return refine_map(
            mesh,
            start,
            target=target,
            pull=pull,
            weights=triangle_weights(mesh, self.floor),
            energy=self.energy,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            detour=True,
        )


@dataclass(frozen=True)
class CertifiedRefinement(NewtonRefinement):
    """A map without folds from any start, pulled to the target as far as it can be trusted.

    Its ladder untangles where few faces are folded alone. So it works where the prediction is
    folded, incomplete, or off by a limb's width.

    The last energy is that of `hierarchical.dirichlet`, which is what is reported. A limb is small
    on the sphere, so that a step there is a long way on the surface: γ grows with the root of how
    much the target shrinks the surroundings of a vertex.

    What the minimisation leaves of the way to the target is added to the target, and it is
    minimised again (Bregman iteration, Osher et al. 2005): shapes drift from the target evenly
    over large parts, and that comes back at less distortion than by a larger γ, which would also
    hold the map at what is uneven in the target.

    Attributes
    ----------
    bregman
        How often that is done: for registered surfaces, not for predictions that may be off.
    untangle_up_to
        Share of folded faces up to which untangling is tried.
    """

    pull: float = 30.0
    energy: str = "sigma"
    floor: float = 1.0
    tolerance: float = 3e-4
    bregman: int = 0
    untangle_up_to: float = 0.01

    def _pull(
        self,
        mesh: Mesh,
        target: Float[np.ndarray, "n 3"],
        trust: Float[np.ndarray, " n"] | None,
    ) -> float | Float[np.ndarray, " n"]:
        pull = self.pull * np.sqrt(shrinking(target, mesh))
        return pull if trust is None else pull * trust

    def _untangled(
        self, mesh: Mesh, u: Float[np.ndarray, "n 3"], *, folded: bool
    ) -> Untangled | None:
        if bad_faces(u, mesh.faces).mean() > self.untangle_up_to:
            return None
        return super()._untangled(mesh, u, folded=folded)

    def _minimised(
        self,
        mesh: Mesh,
        start: Float[np.ndarray, "n 3"],
        target: Float[np.ndarray, "n 3"] | None,
        pull: float | Float[np.ndarray, " n"],
    ) -> Refined:
        refined = super()._minimised(mesh, start, target, pull)
        if target is None or not np.any(pull):
            return refined
        goal = aim = unit(target)
        for _ in range(self.bregman):
            aim = unit(aim + goal - refined.sphere)
            again = super()._minimised(mesh, refined.sphere, aim, pull)
            refined = replace(again, iterations=refined.iterations + again.iterations)
        return refined
