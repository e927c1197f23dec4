"""What all stages share: a folder, an ending, and how they train or pass over items."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from lightning import LightningModule, seed_everything
from torch import Tensor

from gensp.compute import Row, stored_rows
from gensp.errors import GenSPError, TrainingDiverged
from gensp.files import write_text
from gensp.runs import Run
from gensp.stages.speed import compiled_call


class Stage(LightningModule):
    """One stage of the method: a LightningModule that writes into one folder."""

    def __init__(self, *, folder: Path | str = Path(".")) -> None:
        super().__init__()
        self.folder = Path(folder)

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **numbers: Any) -> Self:
        """The stage as the runs before it and the configuration make it.

        Stages that read their predecessors override this: they open `inputs[name].folder / file`
        and hand over what they found as constructor arguments.
        """
        return cls(folder=folder, **numbers)

    def finish(self) -> dict[str, float]:
        """Merge what the verb left, on rank zero after all ranks are done.

        Returns
        -------
        dict
            Metrics for the manifest, the stage's headline first.
        """
        return {}


class FitStage(Stage):
    """A stage that trains: Adam, a cosine schedule over all steps, a history of its losses.

    Every step begins from a random state that depends on the seed and the step alone, so a resumed
    training equals an uninterrupted one. All ranks draw alike and share out what they drew:
    several ranks train as one does, up to rounding. So do the micro-batches of a step whose
    gradients are accumulated: they draw alike, and what is no mean over shapes is added in the
    last of them, when the codes of all have been seen.
    """

    def __init__(
        self, *, learning_rate: float, seed: int = 0, folder: Path | str = Path(".")
    ) -> None:
        super().__init__(folder=folder)
        self.learning_rate = learning_rate
        self.seed = seed
        self.compiled = False  # whether `fast` compiles, see `gensp.stages.speed`
        self._compiled: dict[int, Callable[..., Any]] = {}
        self.history: list[dict[str, float]] = []
        # What a callback has measured at the end of this epoch, for its row of the history.
        self.measured: dict[str, float] = {}

    def configure_optimizers(self) -> dict[str, Any]:
        """Adam with a cosine that ends at zero after the last step."""
        trained = [weight for weight in self.parameters() if weight.requires_grad]
        optimizer = torch.optim.Adam(trained, lr=self.learning_rate)
        steps = max(1, int(self.trainer.estimated_stepping_batches))
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=steps)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def fast(self, network: torch.nn.Module) -> Callable[..., Any]:
        """A network for losses that need its first derivatives alone; compiled if asked for."""
        if not self.compiled:
            return network
        if id(network) not in self._compiled:
            self._compiled[id(network)] = compiled_call(network)
        return self._compiled[id(network)]

    def log_losses(self, **terms: Tensor | float) -> None:
        """Log loss terms as train/<term>, averaged over the epoch and the ranks."""
        for term, value in terms.items():
            self.log(
                f"train/{term}",
                value.detach() if isinstance(value, Tensor) else value,
                on_step=False,
                on_epoch=True,
                batch_size=1,
                sync_dist=True,
            )

    def on_train_batch_start(self, batch: Any, batch_idx: int) -> None:
        """Start the step from its own random state, which its micro-batches share."""
        step = (self.seed * 1_000_003 + self.global_step) * 1_009
        seed_everything(step % 2**32, verbose=False)

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Stop at a loss that is no number: what came after would be none either.

        Raises
        ------
        TrainingDiverged
            The loss is not finite, on any rank.
        """
        loss = outputs["loss"] if isinstance(outputs, Mapping) else outputs
        self._require_finite("the loss", loss is None or bool(torch.isfinite(loss).all()))

    def _require_finite(self, what: str, finite: bool) -> None:
        """All ranks stop where one must: a rank that went on would wait for it in vain."""
        if self._trainer is not None:
            finite = self.trainer.strategy.reduce_boolean_decision(finite)
        if finite:
            return
        raise TrainingDiverged(
            f"{self.folder}: {what} is no finite number in epoch {self.current_epoch}, step "
            f"{self.global_step}; finite ones are required; lower the stage's learning_rate, or "
            "look for its cause with debug=anomaly"
        )

    def part(self, count: int) -> tuple[slice, float]:
        """The rank's part of `count` things that all ranks drew alike, and what its mean weighs.

        The mean over the ranks of weight times mean is the mean over all. A rank for which none is
        left takes the first at weight zero.
        """
        rank, ranks = self.trainer.global_rank, self.trainer.world_size
        mine = len(range(rank, count, ranks))
        return slice(rank, None, ranks) if mine else slice(0, 1), ranks * mine / count

    @property
    def micro_batches(self) -> int:
        """Over how many batches a step's gradients are accumulated; each weighs one of so many."""
        return int(self.trainer.accumulate_grad_batches)

    def total(self, value: Tensor) -> Tensor:
        """The sum over all ranks."""
        if self.trainer.world_size == 1:
            return value
        summed = self.trainer.strategy.reduce(value.clone(), reduce_op="sum")
        return summed if isinstance(summed, Tensor) else value.new_tensor(summed)

    def on_train_epoch_end(self) -> None:
        """Keep the epoch's means; weights that are no numbers are never saved.

        Raises
        ------
        TrainingDiverged
            A weight is not finite, on any rank.
        """
        weights = (bool(torch.isfinite(weight).all()) for weight in self.parameters())
        self._require_finite("a weight", all(weights))
        means = {
            name: float(value)
            for name, value in self.trainer.callback_metrics.items()
            if name.startswith("train/")
        }
        place = {"epoch": self.current_epoch, "step": self.global_step}
        self.history.append({**place, **means, **self.measured})
        self.measured = {}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """The history travels with the weights."""
        checkpoint["history"] = self.history

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take up the history where the weights were saved."""
        self.history = list(checkpoint["history"])

    def finish(self) -> dict[str, float]:
        """Write history.csv; the last epoch's means are the metrics."""
        write_table(self.folder / "history.csv", self.history)
        last = self.history[-1] if self.history else {}
        return {name: value for name, value in last.items() if name not in ("epoch", "step")}


class ItemStage(Stage):
    """A stage that learns nothing: it passes over items and collects one row of each.

    Parameters
    ----------
    table
        Name of the csv file of all rows.
    max_failures
        More failed items than this end the stage with an error; None bears any number.
    """

    def __init__(
        self, *, table: str, max_failures: int | None = 0, folder: Path | str = Path(".")
    ) -> None:
        super().__init__(folder=folder)
        self.table = table
        self.max_failures = max_failures

    def predict_step(self, row: Row, index: int) -> Row:
        """The work was done by the worker that yielded the row."""
        return row

    @property
    def rows(self) -> list[Row]:
        """The rows of all items and ranks, ordered by item."""
        return stored_rows(self.folder)

    def finish(self) -> dict[str, float]:
        """Write the table, or report the items that failed.

        Raises
        ------
        GenSPError
            More items failed than may.
        """
        rows = self.rows
        failed = [row for row in rows if row.get("error")]
        if self.max_failures is not None and len(failed) > self.max_failures:
            first = "; ".join(str(row["error"]) for row in failed[:3])
            raise GenSPError(
                f"{self.folder}: {len(failed)} of {len(rows)} items failed, at most "
                f"{self.max_failures} may; first: {first}"
            )
        write_table(self.folder / f"{self.table}.csv", rows)
        return {"items": len(rows), "failed": len(failed)}


def write_table(
    path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None
) -> None:
    """Write rows as csv; columns as given, else in the order in which they first appear."""
    columns = columns or list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())
