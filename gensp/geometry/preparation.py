"""From a mesh as it was found to one closed genus-0 surface, or to the reason why not."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gensp.errors import BadMesh, EmptyLevelSet
from gensp.geometry.diagnosis import LARGEST_HOLE, Diagnosis, counted, diagnose
from gensp.geometry.distance import hausdorff
from gensp.geometry.mesh import MAX_FACES, Mesh, simplify
from gensp.geometry.repair import bounding_diagonal, remedies, repair, require_steps, sane
from gensp.geometry.retriangulation import retriangulate
from gensp.geometry.self_intersections import self_intersecting_faces

SOLID = "solid"
USABLE, REPAIRED, DROPPED = "usable", "repaired", "dropped"
# With `remesh`: part of the wanted vertices that a mesh gets, drawn for each.
_SIZES = (0.75, 1.0)


@dataclass(frozen=True)
class Prepared:
    """What became of a mesh.

    Attributes
    ----------
    verdict
        "usable": nothing had to be mended; "repaired"; or "dropped".
    found
        The diagnosis of the mesh as it was.
    done
        What was done to it, in words.
    mesh
        The result in the coordinates of the input; None if it was dropped.
    hausdorff
        Distance between input and result, in diagonals of the input; 0 if nothing was done.
    reason, remedy
        Why it was dropped, and what may help.
    self_intersecting
        Faces of the mesh as it was that pass through others.
    """

    verdict: str
    found: Diagnosis
    done: tuple[str, ...] = ()
    mesh: Mesh | None = None
    hausdorff: float | None = None
    reason: str = ""
    remedy: str = ""
    self_intersecting: int | None = 0


@dataclass(frozen=True)
class Preparation:
    """How meshes are prepared. Only what is asked for is done.

    Attributes
    ----------
    repair
        Kinds of mending for a mesh that is not sound: of `gensp.geometry.repair.STEPS`, and
        "solid", the outer surface on a grid, for what the others leave unsound.
    weld, largest_hole
        See `gensp.geometry.repair.repair`.
    solid
        Settings of `gensp.geometry.solid.solid_surface`.
    vertices
        Larger meshes are simplified to about so many; None leaves them.
    remesh
        Give every mesh triangles of its own, so that shared connectivity cannot tell anything.
    max_faces
        Larger results are dropped.
    """

    repair: tuple[str, ...] = ()
    weld: float = 1e-9
    largest_hole: float = LARGEST_HOLE
    solid: Mapping[str, Any] = field(default_factory=dict)
    vertices: int | None = None
    remesh: bool = False
    max_faces: int = MAX_FACES

    def __post_init__(self) -> None:
        """Refuse kinds of mending that do not exist."""
        require_steps(self.repair, more=(SOLID,))

    def __call__(self, mesh: Mesh, generator: np.random.Generator) -> Prepared:
        """Prepare one mesh; the generator draws its triangles under `remesh`."""
        few = len(mesh.faces) <= self.max_faces  # more may take more memory than there is
        crossing = int(self_intersecting_faces(mesh).sum()) if few else None
        return replace(self._prepared(mesh, generator), self_intersecting=crossing)

    def _prepared(self, mesh: Mesh, generator: np.random.Generator) -> Prepared:
        found = self._diagnosed(mesh)
        try:
            sound, done = (mesh, []) if found.usable else self._mended(mesh)
            left = found if sound is mesh else self._diagnosed(sound)
            if not left.usable:
                return Prepared(DROPPED, found, reason=words(left), remedy=self._remedy(left))
            sound, more = self._sized(sound, generator)
        except (BadMesh, EmptyLevelSet) as error:
            return Prepared(DROPPED, found, reason=_bare(error, mesh), remedy=self._remedy(found))
        done += more
        if len(sound.faces) > self.max_faces:
            reason = f"{len(sound.faces)} faces; at most {self.max_faces} are taken"
            return Prepared(DROPPED, found, reason=reason, remedy="recipe.prepare.vertices=5000")
        far = hausdorff(sane(mesh), sound) / bounding_diagonal(sane(mesh)) if done else 0.0
        verdict = USABLE if found.usable else REPAIRED
        return Prepared(verdict, found, tuple(done), sound, far)

    def _diagnosed(self, mesh: Mesh) -> Diagnosis:
        # Its size is judged at the end, when it may have been simplified.
        return diagnose(mesh, max_faces=len(mesh.faces))

    def _mended(self, mesh: Mesh) -> tuple[Mesh, list[str]]:
        own = [step for step in self.repair if step != SOLID]
        done: list[str] = []
        if own:
            kept = repair(mesh, steps=own, weld=self.weld, largest_hole=self.largest_hole)
            mesh, done = kept.mesh, [counted(count, words) for words, count in kept.steps.items()]
        if SOLID in self.repair and not self._diagnosed(mesh).usable:
            mesh, more = self._solid(sane(mesh))
            done += more
        return mesh, done

    def _solid(self, mesh: Mesh) -> tuple[Mesh, list[str]]:
        # Imported late: it needs torch, which takes seconds to load in every worker.
        from gensp.geometry.solid import solid_surface

        found = solid_surface(mesh, **self.solid)
        closed = [f"handles closed by a ball of {found.radius:g} diagonals"] * (found.radius > 0)
        return found.mesh, ["outer surface", *closed]

    def _sized(self, mesh: Mesh, generator: np.random.Generator) -> tuple[Mesh, list[str]]:
        before = len(mesh.vertices)
        if self.remesh:
            wanted = min(self.vertices or before, before) * generator.uniform(*_SIZES)
            mesh = retriangulate(mesh, int(wanted), generator)
            return mesh, [f"triangulated anew, {before} → {len(mesh.vertices)} vertices"]
        if self.vertices is None or before <= self.vertices:
            return mesh, []
        mesh = simplify(mesh, self.vertices)
        return mesh, [f"simplified, {before} → {len(mesh.vertices)} vertices"]

    def _remedy(self, left: Diagnosis) -> str:
        missing = [kind for kind in remedies(left) if kind not in self.repair]
        missing = missing or [SOLID] * (SOLID not in self.repair)
        return f"recipe.prepare.repair: add {', '.join(missing)}" if missing else "mend it by hand"


def words(found: Diagnosis) -> str:
    """All findings of a diagnosis in one line."""
    return ", ".join(what for what, _ in found.findings)


def _bare(error: Exception, mesh: Mesh) -> str:
    """The message of an error without the name of the mesh."""
    return " ".join(str(error).split()).removeprefix(f"{mesh.name}: ")
