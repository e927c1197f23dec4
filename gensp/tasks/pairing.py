"""Stage III-a without a given tree: pairs of inputs registered to each other both ways (ours)."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gensp.compute import Row
from gensp.data.items import item_mesh
from gensp.errors import RegistrationFailed, Unsupported
from gensp.files import content_hash, load_npz, save_npz
from gensp.geometry.guided_registration import Guided, MappedShape, register_guided, restarted
from gensp.geometry.neighbour_pairs import agreeing_pairs, nearest_pairs, star_pairs
from gensp.geometry.registration import Acceptance, RegistrationSettings
from gensp.geometry.spherical_map import SphericalMap
from gensp.layout import item_file, item_folder, lay_out
from gensp.methods.hierarchical import dirichlet
from gensp.tasks.correspond import is_input

SHARED = "shared.npz"  # the surface that all inputs share, which the stage leaves


@dataclass(frozen=True)
class RegisterPair:
    """Register two inputs to each other and write `edges/<a>/<b>.npz` and `edges/<b>/<a>.npz`.

    An item is "a/b", which no id can contain.

    Attributes
    ----------
    augment, implicit, folder
        Where meshes and codes are read, and where edges and maps are written.
    neighbours
        Every input is paired with so many nearest in latent space, and with as many whose maps
        agree best after a rotation: these find the same body in another pose. 0 joins all to the
        one in the middle of latent space (No-GP).
    guides
        Rotations of the guiding maps that are tried; 0: closest points alone.
    settle_from
        First stiffness of the registrations from the root, see `softened`.
    """

    augment: Path
    implicit: Path
    folder: Path
    neighbours: int
    guides: int
    settings: RegistrationSettings
    acceptance: Acceptance
    settle_from: float

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """The input shapes, in the order of Stage II."""
        ids = [str(id) for id in load_npz(self.implicit / "latents.npz")["ids"]]
        return tuple(id for id in ids if is_input(id))

    def codes(self) -> Float[np.ndarray, "k d"]:
        """Their latent codes."""
        stored = load_npz(self.implicit / "latents.npz")
        rows = [k for k, id in enumerate(stored["ids"]) if is_input(str(id))]
        codes: np.ndarray = stored["codes"][rows].astype(np.float64)
        return codes

    def shape(self, id: str) -> MappedShape:
        """An input with its own map, `guides/<id>.npz`, which is made when first asked for."""
        return _shape(self.augment, self.folder, id)

    @property
    def softened(self) -> RegistrationSettings:
        """The settings without their stiffest steps.

        Raises
        ------
        Unsupported
            No step is left.
        """
        soft = tuple(step for step in self.settings.schedule if step[0] <= self.settle_from)
        if not soft:
            raise Unsupported(
                f"recipe.correspond.settle_from={self.settle_from:g}: the schedule has no step as "
                "soft as that; raise it, or lengthen recipe.correspond.paired_schedule"
            )
        return replace(self.settings, schedule=soft)

    def pairs(self) -> list[str]:
        """The items: pairs worth registering."""
        codes = self.codes()
        # Before all others: maps that guide are kept on the way, and there are no more pairs.
        lay_out(self.folder, 2 * max(self.neighbours, 1) * len(codes))
        if self.neighbours == 0:
            chosen = star_pairs(codes)
        else:
            chosen = nearest_pairs(codes, self.neighbours)
            if self.guides:
                signals = [self.shape(id).signal for id in self.ids]
                chosen |= agreeing_pairs(signals, self.neighbours)
        return [f"{self.ids[i]}/{self.ids[j]}" for i, j in sorted(chosen)]

    def __call__(self, item: str) -> Row:
        """A row of both registrations."""
        began = time.perf_counter()
        a, b = item.split("/")
        try:
            ahead, back = self._both(self.shape(a), self.shape(b))
        except RegistrationFailed as error:
            seconds = round(time.perf_counter() - began, 3)
            return {"id": item, "accepted": False, "complaints": str(error), "seconds": seconds}
        self._save(a, b, ahead)
        self._save(b, a, back)
        complaints = [self.acceptance.complaint(found.best) for found in (ahead, back)]
        return {
            "id": item,
            "accepted": complaints == ["", ""],
            "strain": (ahead.best.strain + back.best.strain) / 2,
            "strain_ahead": ahead.best.strain,
            "strain_back": back.best.strain,
            "guide_ahead": ahead.guide,
            "guide_back": back.guide,
            "residual": max(ahead.best.residual, back.best.residual),
            "coverage": max(ahead.best.coverage, back.best.coverage),
            "fold_rate": max(ahead.best.fold_rate, back.best.fold_rate),
            "complaints": "; ".join(text for text in complaints if text),
            "seconds": round(time.perf_counter() - began, 3),
        }

    def _both(self, a: MappedShape, b: MappedShape) -> tuple[Guided, Guided]:
        """Both ways; what strained more is tried again from the inverse of the other."""
        ahead = register_guided(a, b, settings=self.settings, count=self.guides)
        back = register_guided(b, a, settings=self.settings, count=self.guides)
        if ahead.best.strain < back.best.strain:
            return ahead, restarted(b, a, back, ahead, settings=self.settings)
        return restarted(a, b, ahead, back, settings=self.settings), back

    def registered(self, parent: str, child: str) -> Float[np.ndarray, "n 3"]:
        """Vertices of the parent's mesh on the child."""
        vertices: np.ndarray = load_npz(pair_path(self.folder, parent, child))["vertices"]
        return vertices

    def _save(self, parent: str, child: str, found: Guided) -> None:
        save_npz(pair_path(self.folder, parent, child), vertices=found.best.vertices)


def pair_path(folder: Path, parent: str, child: str) -> Path:
    """Where the registration of a parent to a child is kept."""
    return item_folder(folder, "edges", parent) / parent / f"{child}.npz"


def _shape(augment: Path, folder: Path, id: str) -> MappedShape:
    """A shape with its map; the map is kept with the digest of the mesh that it belongs to."""
    mesh = item_mesh(augment, id)
    path = item_file(folder, "guides", id)
    return _mapped(path, content_hash(mesh.vertices, mesh.faces), augment, id)


@lru_cache(maxsize=256)
def _mapped(path: Path, key: str, augment: Path, id: str) -> MappedShape:
    mesh = item_mesh(augment, id)
    stored = load_npz(path) if path.is_file() else {}
    if str(stored.get("mesh")) != key:
        stored = {"sphere": dirichlet()(mesh).sphere, "mesh": np.array(key)}
        save_npz(path, **stored)
    return MappedShape(SphericalMap(stored["sphere"], mesh.vertices, mesh.faces, id))


def pairing_task(
    *,
    inputs: Mapping[str, Any],
    folder: Path,
    guided: bool,
    neighbours: int,
    guides: int,
    registration: Mapping[str, Any],
    schedule: Sequence[Sequence[float]],
    settle_from: float,
    acceptance: Mapping[str, float],
) -> RegisterPair:
    """The task as the configuration gives it.

    Parameters
    ----------
    guided
        Ablation No-GP when off: all inputs are joined straight to the one in the middle.
    schedule
        In place of that of `registration`: it begins stiffer and takes longer.
    """
    return RegisterPair(
        augment=inputs["augment"].folder,
        implicit=inputs["implicit"].folder,
        folder=Path(folder),
        neighbours=neighbours if guided else 0,
        guides=guides,
        settings=replace(RegistrationSettings(**registration), schedule=schedule),
        acceptance=Acceptance(**acceptance),
        settle_from=settle_from,
    )


def pairing_items(
    *, inputs: Mapping[str, Any], folder: Path, task: Callable[..., RegisterPair]
) -> list[str]:
    """The pairs that are registered."""
    return task(inputs=inputs, folder=folder).pairs()
