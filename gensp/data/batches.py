"""Batches of the learning stages, and datasets whose draws depend on (seed, epoch, index) alone.

S_0 opens every batch. The arrays may lie in memory or on disk, where only the rows drawn are read;
a batch is gathered in one go, ahead of the step that needs it. Several ranks share every batch of
one rank out: the mean of their losses is its loss.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from gensp.data.clouds import SurfaceSampler
from gensp.data.store import MappedArray

BatchT = TypeVar("BatchT", bound="SdfBatch | CorrespondenceBatch")
Drawn = tuple[str, int]  # a shape and the number of one of its clouds
Key = tuple[int, int]
Rows = Tensor | MappedArray


# Lightning moves the tensors of a batch to the device in place and refuses frozen dataclasses.
@dataclass
class SdfBatch:
    """Stage II: b shapes, their clouds, and n distance samples of each (negative inside).

    `drawn` names the clouds: which shape, which of its draws. `first` and `weight` are this rank's
    share of the loss, see `EpochDataset.share`.
    """

    ids: list[str]
    drawn: list[Drawn]
    clouds: Float[Tensor, "b c 3"]
    points: Float[Tensor, "b n 3"]
    distances: Float[Tensor, "b n"]
    first: int = 0
    weight: float = 1.0


@dataclass
class CorrespondenceBatch:
    """Stages III-b and IV: n icosphere vertices of each shape and where they belong on it.

    `valid` tells which targets are known; `surface` are k area-uniform points of the shape;
    `drawn` names the clouds; `first` and `weight` are this rank's share of the loss.
    """

    ids: list[str]
    drawn: list[Drawn]
    clouds: Float[Tensor, "b c 3"]
    sphere: Float[Tensor, "b n 3"]
    targets: Float[Tensor, "b n 3"]
    valid: Bool[Tensor, "b n"]
    surface: Float[Tensor, "b k 3"]
    first: int = 0
    weight: float = 1.0


class EpochDataset(Dataset[Any], Generic[BatchT]):
    """A map-style dataset of items that is asked for whole batches.

    Parameters
    ----------
    ids
        All items, S_0 first; S_0 is part of every batch and not counted.
    clouds
        Several draws (i, s, c, 3) of every item's cloud.
    passes
        How often an epoch goes through the items.
    """

    def __init__(
        self, ids: Sequence[str], clouds: Float[Rows, "i s c 3"], *, seed: int, passes: int = 1
    ) -> None:
        self.ids = list(ids)
        self.clouds = clouds
        self.seed = seed
        self.passes = passes
        self.rank, self.ranks = 0, 1

    def __len__(self) -> int:
        return (len(self.ids) - 1) * self.passes

    def __getitem__(self, key: Key | int) -> BatchT:
        return self.__getitems__([key])

    def __getitems__(self, keys: Sequence[Key | int]) -> BatchT:
        """The rank's part of the batch of S_0 and the items named by (epoch, index) pairs."""
        pairs = [key if isinstance(key, tuple) else (0, key) for key in keys]
        mine = pairs[self.rank :: self.ranks]
        items = [0] + [1 + index % (len(self.ids) - 1) for _, index in mine]
        draws = [self._generator(*pairs[0], 0)] + [self._generator(*pair, 1) for pair in mine]
        batch = self.batch(items, draws)
        batch.first, batch.weight = self.share(len(mine), len(pairs))
        return batch

    def share(self, mine: int, total: int) -> tuple[int, float]:
        """Where the shapes begin that count on this rank, and what their mean weighs.

        S_0, which every rank needs, counts on the first. The mean over the ranks of weight times
        mean is the mean over the whole batch. A rank without shapes has S_0 at weight zero.
        """
        first = 1 if self.rank and mine else 0
        counted = mine + (self.rank == 0)
        return first, self.ranks * counted / (1 + total)

    def _generator(self, epoch: int, index: int, part: int) -> torch.Generator:
        state = np.random.SeedSequence([self.seed, epoch, index, part]).generate_state(
            1, np.uint64
        )
        return torch.Generator().manual_seed(int(state[0]))

    def draw_clouds(self, draws: Sequence[torch.Generator]) -> list[int]:
        """Which of its clouds every item shows to the encoder."""
        count = self.clouds.shape[1]
        return [int(torch.randint(count, (), generator=generator)) for generator in draws]

    def batch(self, items: Sequence[int], draws: Sequence[torch.Generator]) -> BatchT:
        """Gather the given items, each with random numbers of its own."""
        raise NotImplementedError


class EpochSampler(DistributedSampler[Any]):
    """Shuffles by (seed, epoch), alike on all ranks; yields (epoch, index).

    It is distributed by name only, so that Lightning leaves it alone: batches are shared out, not
    items.
    """

    def __iter__(self) -> Iterator[Key]:
        for index in super().__iter__():
            yield self.epoch, index


def epoch_loader(
    dataset: EpochDataset[BatchT], *, batch_size: int, rank: int = 0, ranks: int = 1
) -> DataLoader[BatchT]:
    """Batches of `batch_size` shapes over all ranks, S_0 included; this rank's part of each.

    Lightning sets the sampler's epoch.
    """
    dataset.rank, dataset.ranks = rank, ranks
    sampler = EpochSampler(dataset, num_replicas=1, rank=0, shuffle=True, seed=dataset.seed)
    return AheadLoader(
        dataset, batch_size=max(1, batch_size - 1), sampler=sampler, collate_fn=_as_is
    )


class AheadLoader(DataLoader[Any]):
    """Gathers the next batches in a thread while a step computes; their order stays.

    Draws have generators of their own, so the thread changes no number.
    """

    ahead = 2

    def __iter__(self) -> Any:
        """Batches in the sampler's order."""
        return _ahead(super().__iter__(), self.ahead)


def _ahead(batches: Iterator[Any], count: int) -> Iterator[Any]:
    end = object()
    with ThreadPoolExecutor(max_workers=1) as thread:
        waiting = deque(thread.submit(next, batches, end) for _ in range(count))
        while (batch := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, batches, end))
            yield batch


def _as_is(batch: BatchT) -> BatchT:
    return batch


class SdfDataset(EpochDataset[SdfBatch]):
    """Signed distance samples; `points` (i, s, 3) and `distances` (i, s) are the pools."""

    def __init__(
        self,
        ids: Sequence[str],
        clouds: Float[Rows, "i s c 3"],
        points: Float[Rows, "i s 3"],
        distances: Float[Rows, "i s"],
        *,
        count: int,
        seed: int,
        passes: int = 1,
    ) -> None:
        super().__init__(ids, clouds, seed=seed, passes=passes)
        self.points, self.distances = points, distances
        self.count = count

    def batch(self, items: Sequence[int], draws: Sequence[torch.Generator]) -> SdfBatch:
        """Draw `count` samples of every item's pool."""
        which = self.draw_clouds(draws)
        pool = self.points.shape[1]
        chosen = torch.stack([torch.randint(pool, (self.count,), generator=g) for g in draws])
        rows = torch.as_tensor(items)[:, None]
        return SdfBatch(
            ids=[self.ids[item] for item in items],
            drawn=[(self.ids[item], draw) for item, draw in zip(items, which, strict=True)],
            clouds=self.clouds[list(items), which],
            points=self.points[rows, chosen],
            distances=self.distances[rows, chosen],
        )


class CorrespondenceDataset(EpochDataset[CorrespondenceBatch]):
    """Icosphere vertices (v, 3) with their places `targets` (i, v, 3) on every item."""

    def __init__(
        self,
        ids: Sequence[str],
        clouds: Float[Rows, "i s c 3"],
        sphere: Float[Tensor, "v 3"],
        targets: Float[Rows, "i v 3"],
        valid: Bool[Rows, "i v"],
        surfaces: Sequence[SurfaceSampler],
        *,
        count: int,
        surface_count: int,
        seed: int,
        passes: int = 1,
    ) -> None:
        super().__init__(ids, clouds, seed=seed, passes=passes)
        self.sphere, self.targets, self.valid = sphere, targets, valid
        self.surfaces = surfaces
        self.count, self.surface_count = min(count, len(sphere)), surface_count

    def batch(self, items: Sequence[int], draws: Sequence[torch.Generator]) -> CorrespondenceBatch:
        """Draw vertices without replacement, and surface points, for every item."""
        which = self.draw_clouds(draws)
        total = len(self.sphere)
        chosen = torch.stack([torch.randperm(total, generator=g)[: self.count] for g in draws])
        rows = torch.as_tensor(items)[:, None]
        surface = [
            self.surfaces[item].draw(self.surface_count, generator)
            for item, generator in zip(items, draws, strict=True)
        ]
        return CorrespondenceBatch(
            ids=[self.ids[item] for item in items],
            drawn=[(self.ids[item], draw) for item, draw in zip(items, which, strict=True)],
            clouds=self.clouds[list(items), which],
            sphere=self.sphere[chosen],
            targets=self.targets[rows, chosen],
            valid=self.valid[rows, chosen],
            surface=torch.stack(surface),
        )
