"""Training items that stage I leaves behind: the inputs and the shapes between them and S_0."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import numpy as np

from gensp.errors import DamagedFile, MissingStage
from gensp.files import load_npz, read_json
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.layout import item_file

_SPHERE_LEVEL = 5


@dataclass(frozen=True)
class Item:
    """One training shape of the extended collection S_1, …, S_N̄.

    Attributes
    ----------
    id
        The input's id, or "<id>@<k>" for the k-th sample of its flow.
    shape, split
        Id and split of the input that it comes from.
    kind
        "input" or "augmented".
    t
        Position on the flow in (0, 1) by arc length; 0 for inputs.
    """

    id: str
    shape: str
    split: str
    kind: str
    t: float


def training_items(
    folder: Path | str, augmented: bool, splits: tuple[str, ...] = ("train", "val")
) -> list[Item]:
    """Items of stage I in the folder: inputs first, then, if `augmented`, the accepted samples.

    This is where the ablation No-DA is read: it passes augmented=False.

    Raises
    ------
    MissingStage
        The folder holds no finished stage I.
    DamagedFile
        An id is no plain name of a file.
    """
    path = Path(folder) / "items.json"
    if not path.is_file():
        raise MissingStage(
            f"{path}: does not exist; the items of stage I are required; run stage=augment"
        )
    items = [Item(**entry) for entry in read_json(path)]
    # Ids become names of files: none may lead out of the folder that they are written to.
    for id in (name for item in items for name in (item.id, item.shape)):
        if Path(id).name != id:
            raise DamagedFile(
                f"{path}: has the id {id!r}; a plain file name is required; "
                "run stage=augment again"
            )
    kinds = ("input", "augmented") if augmented else ("input",)
    return [item for kind in kinds for item in items if item.kind == kind and item.split in splits]


def item_path(folder: Path | str, item: str) -> Path:
    """Where the mesh of an item is kept."""
    return item_file(Path(folder), "meshes", item)


def item_mesh(folder: Path | str, item: str) -> Mesh:
    """Mesh of an item: closed, genus 0, centred, area 4π, with its own triangulation."""
    arrays = load_npz(item_path(folder, item))
    return Mesh(arrays["vertices"].astype(np.float64), arrays["faces"].astype(np.int64), item)


def sphere_mesh() -> Mesh:
    """S_0 as triangles, of which surface points are drawn and to which distances are taken."""
    return icosphere(_SPHERE_LEVEL)


class ItemMeshes(Sequence[Mesh]):
    """Meshes of named items, read when asked for and not kept."""

    def __init__(self, folder: Path | str, names: Sequence[str]) -> None:
        self.folder, self.names = Path(folder), list(names)

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, place: int) -> Mesh: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Mesh]: ...
    def __getitem__(self, place: int | slice) -> Mesh | Sequence[Mesh]:
        """One mesh, or some of them still unread."""
        if isinstance(place, slice):
            return ItemMeshes(self.folder, self.names[place])
        return item_mesh(self.folder, self.names[place])


def names_of(meshes: Sequence[Mesh]) -> list[str]:
    """Names of meshes, without reading those that are not in memory."""
    return meshes.names if isinstance(meshes, ItemMeshes) else [mesh.name for mesh in meshes]
