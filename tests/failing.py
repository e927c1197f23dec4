"""Faults of a single rank, as callbacks that a command names."""

import errno
from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer


class NoNumber(Callback):
    """A loss of the second rank that is no number, in the third step."""

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, *place: Any
    ) -> None:
        if trainer.global_rank == 1 and trainer.global_step == 3:
            outputs["loss"] = torch.tensor(torch.nan)


class FullDisk(Callback):
    """A disk of the second rank that is full."""

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if trainer.global_rank == 1:
            raise OSError(errno.ENOSPC, "No space left on device", "/full")
