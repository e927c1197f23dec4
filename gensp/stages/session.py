"""The Lightning side of a run: the verb, the seal, the loggers' end."""

import logging
import os
import re
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
from lightning import LightningDataModule, Trainer
from lightning.fabric.plugins.environments import ClusterEnvironment, SLURMEnvironment
from lightning.pytorch.strategies import DDPStrategy

from gensp.errors import RankLost
from gensp.ranks import started_outside
from gensp.runs import CHECKPOINT, Run, seal
from gensp.stages.base import Stage
from gensp.stages.logged import log_pictures
from gensp.stages.memory import rank_memory
from gensp.terminal import report, say

_MEANT_TO_BE_SO = (
    ".*does not have many workers.*",
    ".*`IterableDataset` has `__len__` defined.*",
    ".*smaller than the logging interval.*",
    ".*GPU available but not used.*",
    ".*Experiment logs directory .* exists and is not empty.*",
    ".*Checkpoint directory .* exists and is not empty.*",
    ".*Total length of .* is zero.*",
    ".*LeafSpec.*is deprecated.*",
)


# What gloo, NCCL and torch's store say of a connection whose other end is gone.
_LOST = re.compile("gloo/transport|remote process exited|failed to recv|recvValue failed")


def quiet() -> None:
    """Leave out Lightning's remarks on what is meant to be so here."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    # What debug=profile asks for is printed at the end, as information.
    logging.getLogger("lightning.pytorch.profilers").setLevel(logging.INFO)
    for remark in _MEANT_TO_BE_SO:
        warnings.filterwarnings("ignore", remark)


def threads() -> int:
    """OMP_NUM_THREADS, else the cores, shared with other ranks of a torchrun on this machine."""
    if os.environ.get("OMP_NUM_THREADS", "").isdigit():
        return int(os.environ["OMP_NUM_THREADS"])
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, (own or 1) // int(os.environ.get("LOCAL_WORLD_SIZE", "1")))


def ddp(hours: float) -> DDPStrategy:
    """Ranks that wait so long for each other.

    While the first makes the ending of a stage, or items of another take their time, the others
    wait; torch's half an hour is soon over.
    """
    return DDPStrategy(timeout=timedelta(hours=hours))


def environments() -> list[ClusterEnvironment]:
    """SLURM, where it started this process, without Lightning's own way to go on in a new job.

    That saves within an epoch, whence a training cannot be resumed exactly; a stage goes on from
    its own checkpoint when the same command runs again.
    """
    return [SLURMEnvironment(auto_requeue=False)] if started_outside() == "slurm" else []


def gather(trainer: Trainer) -> None:
    """Let ranks that were started together wait for the first, which alone checks what is read.

    It comes here when all was found whole; else it ends with the reason, and whoever started them
    ends the others. Ranks that Lightning starts are started after that.
    """
    if started_outside() and trainer.world_size > 1:
        trainer.strategy.setup_environment()
        trainer.strategy.barrier("inputs")


@contextmanager
def together(folder: Path) -> Iterator[None]:
    """What ranks do with each other, of which some may end too early.

    Raises
    ------
    RankLost
        One has; what torch says of the broken connection is pages long.
    """
    try:
        yield
    except RuntimeError as error:
        if not _LOST.search(str(error)):
            raise
        raise RankLost(
            f"{folder}: another rank ended before its work was done; all are required to the end; "
            "mend what its own line or traceback tells, and run the same command again"
        ) from error


def carry_out(
    trainer: Trainer, verb: str, module: Stage, data: LightningDataModule, *, resume: bool
) -> None:
    """Fit or predict; a fit goes on from its last checkpoint."""
    if verb == "predict":
        trainer.predict(module, datamodule=data, return_predictions=False)
        return
    saved = module.folder / CHECKPOINT
    found = resume and saved.is_file()
    if found:
        say("      resumed from its last checkpoint")
    trainer.fit(module, datamodule=data, ckpt_path=str(saved) if found else None)


def conclude(
    trainer: Trainer,
    module: Stage,
    *,
    settings: Mapping[str, Any],
    inputs: Mapping[str, Run],
    began: float,
    resumed: bool = False,
) -> float | None:
    """Rank zero merges and seals; the others wait, so that they find the manifest."""
    trainer.strategy.barrier("verb")
    memory = rank_memory(trainer)
    if trainer.is_global_zero:
        metrics = module.finish()
        seconds = round(time.monotonic() - began, 3)
        facts = {
            "inputs": {name: run.outputs for name, run in inputs.items()},
            "seconds": seconds,
            **memory.facts(module.folder),
            # Then seconds and memory are those of the last session alone.
            "resumed": resumed,
            "device": _device(trainer),
            "threads": torch.get_num_threads(),
            "ranks": trainer.world_size,
        }
        for logger in trainer.loggers:
            logger.log_metrics({f"end/{name}": value for name, value in metrics.items()})
            log_pictures(logger, module.folder / "pictures")
            logger.save()
        stage = settings["stage"]["name"]
        seal(module.folder, stage=stage, settings=settings, metrics=metrics, facts=facts)
        report(module.folder, metrics, seconds)
    trainer.strategy.barrier("seal")
    return Run(module.folder).headline


def _device(trainer: Trainer) -> str:
    root = trainer.strategy.root_device
    return torch.cuda.get_device_name(root) if root.type == "cuda" else root.type


def close(loggers: Sequence[Any]) -> None:
    """Finish what the loggers keep open, also when the stage failed."""
    failed = sys.exc_info()[0] is not None
    for logger in loggers:
        logger.finalize("failed" if failed else "success")
        finish = getattr(logger.experiment, "finish", None)
        if callable(finish):
            finish()
