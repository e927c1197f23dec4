"""Stage III-a on one edge of the tree: the parent's mesh registered to the child (paper §4.3)."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gensp.compute import Row
from gensp.data.items import item_mesh
from gensp.data.shapes import SPHERE
from gensp.errors import BadMesh, EmptyLevelSet, RegistrationFailed
from gensp.files import load_npz, save_npz
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration import (
    Acceptance,
    Attempts,
    Registration,
    RegistrationSettings,
    register_with_retries,
)
from gensp.geometry.spanning_tree import Tree, ancestors, spanning_tree
from gensp.geometry.sphere import icosphere
from gensp.layout import item_file


@dataclass(frozen=True)
class ShapeTree:
    """The tree over all training items, by name; S_0 is the root.

    Attributes
    ----------
    codes
        Latent codes (k, d), zero for S_0.
    used
        Nodes (k,) that are inputs or lie on the way to one: the others are never registered.
    """

    ids: tuple[str, ...]
    codes: Float[np.ndarray, "k d"]
    tree: Tree
    used: Bool[np.ndarray, " k"]

    @classmethod
    def over(cls, latents: Path, kind: str) -> "ShapeTree":
        """Span the tree over the codes that Stage II left."""
        arrays = load_npz(latents)
        ids = tuple(str(id) for id in arrays["ids"])
        codes = arrays["codes"].astype(np.float64)
        tree = spanning_tree(codes, ids.index(SPHERE), kind)
        inputs = [k for k, id in enumerate(ids) if is_input(id)]
        return cls(ids, codes, tree, ancestors(tree, inputs))

    @property
    def edges(self) -> dict[str, str]:
        """Child → parent of the edges in use, parents before children."""
        children = (k for k in self.tree.order[1:] if self.used[k])
        return {self.ids[k]: self.ids[self.tree.parent[k]] for k in children}


def is_input(id: str) -> bool:
    """Whether an item is an input shape: neither S_0 nor a sample "<id>@<k>" of a flow."""
    return id != SPHERE and "@" not in id


@dataclass(frozen=True)
class LevelSets:
    """How interpolated level sets become meshes: cells along the longest side, vertices."""

    resolution: int = 64
    vertices: int = 2500


@dataclass(frozen=True)
class RegisterEdge:
    """Register a parent's mesh to its child and write `edges/<child>.npz`.

    Attributes
    ----------
    augment, implicit, folder
        Where meshes and codes are read, and where edges are written.
    kind
        Of the tree: minimum, shortest, or star (No-GP).
    ladder
        Settings that are tried in turn; the paper's interpolants are a number in them.
    sphere_level
        Icosphere that stands for S_0 as a mesh.
    """

    augment: Path
    implicit: Path
    folder: Path
    kind: str
    ladder: Sequence[RegistrationSettings]
    acceptance: Acceptance
    level_sets: LevelSets
    sphere_level: int

    @cached_property
    def shapes(self) -> ShapeTree:
        """The tree whose edges are the items."""
        return ShapeTree.over(self.implicit / "latents.npz", self.kind)

    def mesh(self, id: str) -> Mesh:
        """Mesh of a node."""
        if id == SPHERE:
            return icosphere(self.sphere_level)
        return item_mesh(self.augment, id)

    def __call__(self, child: str) -> Row:
        """Register the tree's own edge to `child`."""
        return self.join(child, self.shapes.edges[child])

    def join(self, child: str, parent: str) -> Row:
        """Register any `parent` to `child`; a row of diagnostics, `accepted` among them.

        `interpolants` tells how many level sets were used of those asked for, attempt by attempt;
        it is empty where none were.
        """
        start = time.perf_counter()
        row: Row = {"id": child, "parent": parent}
        between: list[str] = []

        def interpolate(count: int) -> list[Mesh]:
            found = self._between(parent, child, count)
            between.append(f"{len(found)} of {count}")
            return found

        try:
            attempts = register_with_retries(
                self.mesh(parent),
                self.mesh(child),
                ladder=self.ladder,
                acceptance=self.acceptance,
                interpolate=interpolate,
            )
        except RegistrationFailed as error:
            row |= {"accepted": False, "attempts": len(self.ladder), "complaints": str(error)}
            row["interpolants"] = "; ".join(between)
        else:
            row |= _diagnostics(attempts) | {"interpolants": "; ".join(between)}
            save_npz(edge_path(self.folder, child), vertices=attempts.best.vertices, **row)
        return row | {"seconds": round(time.perf_counter() - start, 3)}

    def _between(self, parent: str, child: str, count: int) -> list[Mesh]:
        """Level sets of f at codes between two nodes; those that are no sphere are left out."""
        rows = [self.shapes.ids.index(id) for id in (parent, child)]
        first, last = self.shapes.codes[rows]
        extent = max(float(np.abs(self.mesh(id).vertices).max()) for id in (parent, child))
        meshes = []
        for share in np.arange(1, count + 1) / (count + 1):
            try:
                surface = self._surface((1 - share) * first + share * last, 1.25 * extent)
            except (EmptyLevelSet, BadMesh):
                continue
            meshes.append(surface)
        return meshes

    def _surface(self, code: Float[np.ndarray, " d"], bound: float) -> Mesh:
        # Torch is only paid for where level sets are asked for.
        import torch

        from gensp.geometry.levelset import extract_surface
        from gensp.models.store import load_model

        field = load_model(self.implicit / "model.pt")["field"]
        z = torch.as_tensor(code, dtype=torch.float32)[None]
        return extract_surface(
            lambda x: field(z, x[None])[0],
            resolution=self.level_sets.resolution,
            vertices=self.level_sets.vertices,
            bounds=bound,
        )


def edge_path(folder: Path, child: str) -> Path:
    """Where the registered edge to `child` is kept."""
    return item_file(folder, "edges", child)


def _diagnostics(attempts: Attempts) -> Row:
    numbers = asdict(replace(attempts.best, vertices=np.zeros((0, 3))))
    del numbers["vertices"]
    return {
        "accepted": attempts.accepted,
        **numbers,
        "attempts": len(attempts.complaints),
        "complaints": "; ".join(text for text in attempts.complaints if text),
    }


def judged(found: Registration, acceptance: Acceptance) -> Row:
    """Whether a further registration of a source that all share is kept, and by which figures."""
    complaint = acceptance.complaint(found)
    return {
        "kept": complaint == "",
        "residual": found.residual,
        "coverage": found.coverage,
        "fold_rate": found.fold_rate,
        "complaints": complaint,
    }


def correspond_task(
    *,
    inputs: Mapping[str, Any],
    folder: Path,
    guided: bool,
    tree: str,
    registration: Mapping[str, Any],
    retries: Sequence[Mapping[str, Any]],
    acceptance: Mapping[str, float],
    level_sets: Mapping[str, int],
    sphere_level: int,
) -> RegisterEdge:
    """The task as the configuration gives it.

    Parameters
    ----------
    guided
        Ablation No-GP when off: every shape is joined straight to the sphere.
    retries
        What each further rung of the ladder changes in `registration`.
    """
    first = RegistrationSettings(**registration)
    return RegisterEdge(
        augment=inputs["augment"].folder,
        implicit=inputs["implicit"].folder,
        folder=Path(folder),
        kind=tree if guided else "star",
        ladder=(first, *(replace(first, **changes) for changes in retries)),
        acceptance=Acceptance(**acceptance),
        level_sets=LevelSets(**level_sets),
        sphere_level=sphere_level,
    )


def correspond_items(
    *, inputs: Mapping[str, Any], folder: Path, task: Callable[..., RegisterEdge]
) -> list[str]:
    """Children of the edges in use."""
    return list(task(inputs=inputs, folder=folder).shapes.edges)
