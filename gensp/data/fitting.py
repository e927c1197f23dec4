"""What the DataModules of the learning stages share: how batches are drawn, arrays on disk."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jaxtyping import Float
from lightning import LightningDataModule
from torch.utils.data import DataLoader

from gensp.data.arrays import Content, TrainingArrays
from gensp.data.batches import EpochDataset
from gensp.data.items import names_of
from gensp.data.loading import epoch_loader
from gensp.data.mapped import MappedArray
from gensp.data.modules import places
from gensp.data.shapes import SPHERE
from gensp.geometry.mesh import Mesh


@dataclass(frozen=True)
class Batching:
    """How batches are drawn.

    Attributes
    ----------
    size
        Shapes in a batch over all ranks, S_0 included; accumulated gradients are those of as many
        times more.
    points
        Samples (II) or icosphere vertices (III-b, IV) of every shape.
    surface_points
        Area-uniform points of every shape (III-b, IV).
    passes
        How often one epoch goes through the items.
    cloud, draws
        Points of the encoder's cloud, and number of clouds drawn of every shape.
    """

    size: int = 16
    points: int = 1024
    surface_points: int = 0
    passes: int = 1
    cloud: int = 1024
    draws: int = 1


class FitModule(LightningDataModule):
    """Items that stay on disk; see `gensp.data.batches` for how batches are drawn.

    Parameters
    ----------
    meshes
        One after another they are gone through; those of `ItemMeshes` are not kept.
    cache
        Where the arrays are kept that batches are drawn from; without, a folder that is thrown
        away with this module.

    Attributes
    ----------
    ids
        All items of an epoch in fixed order, S_0 first.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        *,
        batching: Batching,
        seed: int,
        cache: Path | str | None,
    ) -> None:
        super().__init__()
        self.meshes = meshes
        self.ids = [SPHERE, *names_of(meshes)]
        self.batching = batching
        self.seed = seed
        if cache is None:
            self._thrown_away = tempfile.TemporaryDirectory(prefix="gensp-")
            cache = self._thrown_away.name
        self.stores = Path(cache) / "training"
        # The cache is seen by all machines, as the run folder is.
        self.prepare_data_per_node = False

    @cached_property
    def arrays(self) -> TrainingArrays:
        """What batches are drawn from; the meshes are gone through once to name it."""
        contents = [Content.of(mesh) for mesh in self.meshes]
        return TrainingArrays(self.stores, self.meshes, contents)

    @cached_property
    def clouds(self) -> Float[MappedArray, "items s c 3"]:
        """The items' encoder clouds in the order of `ids`, several draws of each."""
        return self.arrays.clouds(self.batching.cloud, self.batching.draws)

    def prepare_data(self) -> None:
        """Name, check and write the arrays, on one rank."""
        _ = self._loaded

    def setup(self, stage: str) -> None:
        """Tell the other ranks what the first has found; they open it and check nothing."""
        if self.trainer is None or self.trainer.world_size == 1:
            return
        first = self.trainer.global_rank == 0
        found: Any = (self.arrays.contents, self.arrays.known) if first else None
        contents, known = self.trainer.strategy.broadcast(found)
        if not first:
            self.arrays = TrainingArrays(self.stores, self.meshes, contents, known)

    @cached_property
    def _loaded(self) -> EpochDataset[Any]:
        return self.dataset()

    def dataset(self) -> EpochDataset[Any]:
        """What the batches are drawn from."""
        raise NotImplementedError

    def train_dataloader(self) -> DataLoader[Any]:
        """The share of this rank of every epoch.

        K accumulated batches are one of K times the shapes, S_0 once, in K micro-batches.
        """
        rank, ranks, _ = places(self.trainer)
        micro = self.trainer.accumulate_grad_batches if self.trainer else 1
        size = self.batching.size * micro
        return epoch_loader(self._loaded, batch_size=size, micro=micro, rank=rank, ranks=ranks)
