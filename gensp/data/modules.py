"""The DataModule of the stages that pass over items: shapes, tree edges, pairs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Self

from lightning import LightningDataModule, Trainer
from torch.utils.data import DataLoader, IterableDataset

from gensp.compute import Row, Task, run_items
from gensp.layout import lay_out
from gensp.runs import Run
from gensp.sharing import Workers


class ItemRows(IterableDataset[Row]):
    """Rows of the items, in the order in which the workers finish them.

    `ranks` of this machine have items of their own at the same time.
    """

    def __init__(
        self, task: Task, items: Sequence[str], folder: Path, workers: Workers, *, ranks: int = 1
    ) -> None:
        self.task, self.items, self.folder = task, items, folder
        self.workers, self.ranks = workers, ranks

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Row]:
        return run_items(self.task, self.items, self.folder, self.workers, ranks=self.ranks)


class ItemsModule(LightningDataModule):
    """Items shared out over the ranks, and over the workers of every rank.

    Parameters
    ----------
    task
        What is done with one item: its name in, its row out, its files written on the way.
    items
        Names of all items.
    folder
        Where rows, and the task's files, are written.
    """

    def __init__(
        self, *, task: Task, items: Sequence[str], folder: Path, workers: Workers | None = None
    ) -> None:
        super().__init__()
        self.task, self.items, self.folder = task, list(items), Path(folder)
        self.workers = workers or Workers()
        # A rank may be left without an item.
        self.allow_zero_length_dataloader_with_multiple_devices = True
        # The run folder is seen by all machines.
        self.prepare_data_per_node = False

    @classmethod
    def from_runs(
        cls,
        inputs: Mapping[str, Run],
        folder: Path,
        *,
        task: Callable[..., Task],
        items: Callable[..., Sequence[str]] | Sequence[str],
        workers: Workers | None = None,
    ) -> Self:
        """The items of a stage.

        Parameters
        ----------
        task
            Called as task(inputs=..., folder=...); gives the work on one item.
        items
            The names, or called as items(inputs=..., folder=...) to give them.
        """
        names = items(inputs=inputs, folder=folder) if callable(items) else items
        return cls(
            task=task(inputs=inputs, folder=folder), items=names, folder=folder, workers=workers
        )

    def prepare_data(self) -> None:
        """Decide where the items' files lie, on one rank, which alone knows of all items."""
        lay_out(self.folder, len(self.items) * getattr(self.task, "files_each", 1))

    def predict_dataloader(self) -> DataLoader[Row]:
        """The share of this rank, one finished row at a time."""
        rank, ranks, here = places(self.trainer)
        mine = self.items[rank::ranks]
        return DataLoader(
            ItemRows(self.task, mine, self.folder, self.workers, ranks=here), batch_size=None
        )


def places(trainer: Trainer | None) -> tuple[int, int, int]:
    """The own rank, the number of all ranks, and of those that share this machine's cores."""
    if trainer is None:
        return 0, 1, 1
    return trainer.global_rank, trainer.world_size, trainer.num_devices
