"""Batches of the learning stages, and datasets whose draws depend on (seed, epoch, index) alone.

S_0 opens every batch. The arrays may lie in memory or on disk, where only the rows drawn are read;
a batch is gathered in one go, ahead of the step that needs it. The batch of an optimiser step is
shared out over the ranks, and over the micro-batches whose gradients are accumulated: the mean of
the losses of all its parts is its loss.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils.data import Dataset

from gensp.data.clouds import SurfaceSampler
from gensp.data.mapped import MappedArray

BatchT = TypeVar("BatchT", bound="SdfBatch | CorrespondenceBatch")
Drawn = tuple[str, int]  # a shape and the number of one of its clouds
Rows = Tensor | MappedArray
Key = tuple[int, int]  # an epoch and the place of an item in it


@dataclass(frozen=True)
class Micro:
    """One of the micro-batches of an optimiser step, by the keys of the whole step."""

    keys: tuple[Key, ...]
    number: int


# Lightning moves the tensors of a batch to the device in place and refuses frozen dataclasses.
@dataclass
class SdfBatch:
    """Stage II: b shapes, their clouds, and n distance samples of each (negative inside).

    `drawn` names the clouds: which shape, which of its draws. `first` and `weight` are this part's
    share of the loss, see `EpochDataset.share`; `ends` tells the last micro-batch of a step.
    """

    ids: list[str]
    drawn: list[Drawn]
    clouds: Float[Tensor, "b c 3"]
    points: Float[Tensor, "b n 3"]
    distances: Float[Tensor, "b n"]
    first: int = 0
    weight: float = 1.0
    ends: bool = True


@dataclass
class CorrespondenceBatch:
    """Stages III-b and IV: n icosphere vertices of each shape and where they belong on it.

    `valid` tells which targets are known; `surface` are k area-uniform points of the shape;
    `drawn` names the clouds; `first`, `weight` and `known_weight` are this part's share of the
    loss, as a mean over shapes and over valid targets; `ends` tells a step's last micro-batch.
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
    known_weight: float = 1.0
    ends: bool = True


class EpochDataset(Dataset[Any], Generic[BatchT]):
    """The micro-batches of an epoch, in the items' own order: what debug=overfit repeats.

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
        self.count = (len(self.ids) - 1) * passes
        self.share_out(self.count + 1)

    def share_out(self, size: int, *, micro: int = 1, rank: int = 0, ranks: int = 1) -> None:
        """Batches of `size` shapes, S_0 included, in `micro` micro-batches over some ranks."""
        self.others, self.micro = max(1, size - 1), micro
        self.rank, self.ranks = rank, ranks

    def __len__(self) -> int:
        return -(-self.count // self.others) * self.micro

    def micros(self, keys: Sequence[Key]) -> Iterator[Micro]:
        """The micro-batches of an epoch whose items come in this order.

        Every step has all of its micro-batches, for Lightning counts them: one for which no shape
        is left holds S_0 at weight zero.
        """
        for start in range(0, len(keys), self.others):
            step = tuple(keys[start : start + self.others])
            yield from (Micro(step, number) for number in range(self.micro))

    def __getitem__(self, which: Micro | int) -> BatchT:
        """The rank's part of a micro-batch: S_0 and some of the step's items."""
        micro = self._micro(which)
        keys, parts = micro.keys, self.ranks * self.micro
        part = micro.number * self.ranks + self.rank
        mine = keys[part::parts]
        batch = self.batch(*self._named(keys[0], mine))
        batch.first, batch.weight = self.share(part, len(mine), len(keys))
        batch.ends = micro.number == self.micro - 1
        return batch

    def _micro(self, which: Micro | int) -> Micro:
        if isinstance(which, Micro):
            return which
        return list(self.micros([(0, index) for index in range(self.count)]))[which]

    def _named(self, opening: Key, keys: Sequence[Key]) -> tuple[list[int], list[torch.Generator]]:
        """Items, S_0 first, and the random numbers of each; those of S_0 are the step's."""
        items = [0] + [1 + index % (len(self.ids) - 1) for _, index in keys]
        return items, [self._generator(*opening, 0), *(self._generator(*key, 1) for key in keys)]

    def share(self, part: int, mine: int, total: int) -> tuple[int, float]:
        """Where the shapes begin that count in a part, and what their mean weighs.

        S_0, which every part needs, counts in the first. The mean over the parts of weight times
        mean is the mean over the whole batch. A part without shapes has S_0 at weight zero.
        """
        first = 1 if part and mine else 0
        counted = mine + (part == 0)
        return first, self.ranks * self.micro * counted / (1 + total)

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
        self.pool, self.distances = points, distances
        self.points = count

    def batch(self, items: Sequence[int], draws: Sequence[torch.Generator]) -> SdfBatch:
        """Draw `count` samples of every item's pool."""
        which = self.draw_clouds(draws)
        pool = self.pool.shape[1]
        chosen = torch.stack([torch.randint(pool, (self.points,), generator=g) for g in draws])
        rows = torch.as_tensor(items)[:, None]
        return SdfBatch(
            ids=[self.ids[item] for item in items],
            drawn=[(self.ids[item], draw) for item, draw in zip(items, which, strict=True)],
            clouds=self.clouds[list(items), which],
            points=self.pool[rows, chosen],
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
        self.points, self.surface_count = min(count, len(sphere)), surface_count

    def __getitem__(self, which: Micro | int) -> CorrespondenceBatch:
        """With what the mean over its valid targets weighs among those of the whole step."""
        batch = super().__getitem__(which)
        parts = self.ranks * self.micro
        if parts > 1:
            known = batch.valid[batch.first :].sum().item() * (batch.weight > 0)
            batch.known_weight = parts * known / max(1, self._known(self._micro(which).keys))
        return batch

    def _known(self, keys: Sequence[Key]) -> int:
        """Valid targets of a whole step, drawn as its parts draw them."""
        items, draws = self._named(keys[0], keys)
        self.draw_clouds(draws)
        return int(self.valid[torch.as_tensor(items)[:, None], self._chosen(draws)].sum())

    def _chosen(self, draws: Sequence[torch.Generator]) -> Int[Tensor, "b n"]:
        """Vertices without replacement."""
        total = len(self.sphere)
        return torch.stack([torch.randperm(total, generator=g)[: self.points] for g in draws])

    def batch(self, items: Sequence[int], draws: Sequence[torch.Generator]) -> CorrespondenceBatch:
        """Draw vertices, and surface points, for every item."""
        which, chosen = self.draw_clouds(draws), self._chosen(draws)
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
