"""The batches of an epoch, in its order, gathered ahead of the steps that need them."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch.utils.data import DataLoader, DistributedSampler

from gensp.data.batches import BatchT, EpochDataset, Micro


class EpochSampler(DistributedSampler[Any]):
    """Shuffles by (seed, epoch), alike on all ranks; yields micro-batches.

    It is distributed by name only, so that Lightning leaves it alone: batches are shared out, not
    items.
    """

    def __init__(self, dataset: EpochDataset[Any]) -> None:
        super().__init__(dataset, num_replicas=1, rank=0, seed=dataset.seed)
        self.batches = dataset

    def __iter__(self) -> Iterator[Micro]:
        # A generator: a resumed training sets the epoch after it has asked for the iterator.
        generator = torch.Generator().manual_seed(self.seed + self.epoch)
        order = torch.randperm(self.batches.count, generator=generator).tolist()
        yield from self.batches.micros([(self.epoch, index) for index in order])


def epoch_loader(
    dataset: EpochDataset[BatchT],
    *,
    batch_size: int,
    micro: int = 1,
    rank: int = 0,
    ranks: int = 1,
) -> DataLoader[BatchT]:
    """The rank's part of every micro-batch of an epoch.

    Lightning sets the sampler's epoch.

    Parameters
    ----------
    batch_size
        Shapes in the batch of an optimiser step over all ranks and micro-batches, S_0 included.
    """
    dataset.share_out(batch_size, micro=micro, rank=rank, ranks=ranks)
    return AheadLoader(dataset, batch_size=None, sampler=EpochSampler(dataset), collate_fn=_as_is)


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
