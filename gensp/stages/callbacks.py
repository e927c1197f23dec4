"""What accompanies a stage: its progress, the point from which it resumes."""

import io
import time
from pathlib import Path
from typing import Any

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint, ProgressBar
from lightning.pytorch.plugins.io import TorchCheckpointIO
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from gensp.errors import DamagedFile
from gensp.files import atomic_path, require_whole_archive
from gensp.runs import CHECKPOINT


class LastCheckpoint(Checkpoint):
    """Save checkpoints/last.ckpt in the stage's folder at ends of epochs and of the training.

    Parameters
    ----------
    every_seconds
        An epoch that ends sooner than this after the last save is not saved.
    """

    def __init__(self, *, every_seconds: float = 30.0) -> None:
        self.every_seconds = every_seconds
        self._saved = time.monotonic()

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """The interval counts from here."""
        self._saved = time.monotonic()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save when the interval is over; rank zero's clock decides for all."""
        due = time.monotonic() - self._saved >= self.every_seconds
        last = trainer.max_epochs is not None and trainer.current_epoch + 1 >= trainer.max_epochs
        if not trainer.fast_dev_run and trainer.strategy.broadcast(due or last):
            trainer.save_checkpoint(Path(pl_module.folder) / CHECKPOINT)
            self._saved = time.monotonic()


_REMEDY = "remove it to train from the start, or restore it"


class WholeCheckpoints(TorchCheckpointIO):
    """Checkpoints that are renamed into place: a killed run leaves the old one or the new one."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None
    ) -> None:
        """Serialise in memory, so that a full disk is met by a plain write."""
        data = io.BytesIO()
        torch.save(checkpoint, data)
        with atomic_path(path) as temporary:
            temporary.write_bytes(data.getbuffer())

    def load_checkpoint(
        self,
        path: str | Path,
        map_location: Any = lambda storage, location: storage,
        weights_only: bool | None = True,
    ) -> dict[str, Any]:
        """Read plain tensors and numbers, after their checksums: torch itself compares none.

        Raises
        ------
        DamagedFile
            The file is not what was written.
        """
        try:
            require_whole_archive(path, remedy=_REMEDY)
            return torch.load(path, map_location=map_location, weights_only=True)
        except DamagedFile:
            raise
        # Unpicklers raise whatever they meet; the file is at fault in each case.
        except Exception as error:
            raise DamagedFile(
                f"{path}: is damaged ({' '.join(str(error).split())[:120]}); a whole checkpoint "
                f"is required to go on; {_REMEDY}"
            ) from error


class StageProgress(ProgressBar):
    """One bar for a whole stage, in optimiser steps or items, with rate and remaining time.

    Where the output is no terminal, a line is written every `every_percent` or `every_seconds`.
    """

    def __init__(self, *, every_percent: float = 10.0, every_seconds: float = 30.0) -> None:
        super().__init__()
        self.every_percent, self.every_seconds = every_percent, every_seconds
        self._enabled = True
        self._unit = "items"
        self._total = self._first = self._done = 0
        self._began = self._told = 0.0
        self._console = Console()
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def disable(self) -> None:
        """Say nothing, as on every rank but the first."""
        self._enabled = False

    def enable(self) -> None:
        """Speak again."""
        self._enabled = True

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Count optimiser steps, those of a resumed run included."""
        self._open("steps", int(trainer.estimated_stepping_batches), trainer.global_step)

    def on_train_batch_end(self, trainer: Trainer, *_: Any) -> None:
        """One batch further."""
        self._advance(trainer.global_step, _loss(trainer))

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """The last step."""
        self._close()

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Count the items of this rank."""
        self._open("items", int(sum(trainer.num_predict_batches)), 0)

    def on_predict_batch_end(self, *_: Any, **__: Any) -> None:
        """One item further."""
        self._advance(self._done + 1, "")

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """The last item."""
        self._close()

    def on_exception(self, *_: Any) -> None:
        """Leave the terminal in order."""
        self._close()

    def _open(self, unit: str, total: int, done: int) -> None:
        self._unit, self._total, self._first, self._done = unit, total, done, done
        self._began = self._told = time.monotonic()
        if self._enabled and self._console.is_terminal:
            columns = (BarColumn(), TextColumn("{task.description}"))
            self._bar = Progress(*columns, console=self._console)
            self._task = self._bar.add_task(self._line(""), total=total, completed=done)
            self._bar.start()

    def _advance(self, done: int, note: str) -> None:
        before, self._done = self._done, done
        if not self._enabled:
            return
        if self._bar is not None:
            self._bar.update(self._task, completed=done, description=self._line(note))
            return
        step = max(1.0, self._total * self.every_percent / 100)
        late = time.monotonic() - self._told >= self.every_seconds
        if before // step != done // step or late or done == self._total:
            self._told = time.monotonic()
            self._console.print(f"      {self._line(note)}", highlight=False)

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _line(self, note: str) -> str:
        seconds = time.monotonic() - self._began
        passed = self._done - self._first
        parts = [f"{self._done}/{self._total} {self._unit}"]
        if passed:
            remaining = seconds / passed * (self._total - self._done)
            parts += [_rate(passed / max(seconds, 1e-9)), f"{_clock(remaining)} left"]
        return " · ".join([*parts, _clock(seconds), *([note] if note else [])])


def _loss(trainer: Trainer) -> str:
    names = [name for name in trainer.callback_metrics if name.startswith("train/")]
    shown = "train/loss" if "train/loss" in names else next(iter(names), None)
    if shown is None:
        return ""
    return f"{shown.removeprefix('train/')} {float(trainer.callback_metrics[shown]):.4g}"


def _rate(per_second: float) -> str:
    return f"{per_second:.1f}/s" if per_second >= 1 else f"{1 / per_second:.1f} s each"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return (
        f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
        if minutes >= 60
        else f"{minutes}:{rest:02d}"
    )
