"""From a configuration to a finished stage; the only module that makes objects from it."""

import errno
import logging
import os
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from hydra import compose
from hydra.errors import CompactHydraException
from hydra.utils import instantiate
from lightning import Trainer, seed_everything
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import DictConfig, OmegaConf

from gensp.errors import GenSPError, OutputError, Unsupported
from gensp.files import write_text
from gensp.runs import CHECKPOINT, Progress, Run, Runs, begin, clear, restart, seal
from gensp.stages.base import Stage
from gensp.stages.callbacks import WholeCheckpoints
from gensp.terminal import announce, complain, report, say

_TRAINER_SCIENCE = (
    "max_epochs",
    "max_steps",
    "precision",
    "accumulate_grad_batches",
    "gradient_clip_val",
    "limit_train_batches",
)
_FULL_OR_FORBIDDEN = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM}


def run(cfg: DictConfig, overrides: Sequence[str] = ()) -> float | None:
    """Run the stage that the configuration names, or the whole pipeline.

    Parameters
    ----------
    overrides
        What was typed to get `cfg`; a pipeline composes its stages from it.
    """
    if cfg.stage.name == "all":
        return run_pipeline(cfg, overrides)
    return run_stage(cfg, overrides)


def run_pipeline(cfg: DictConfig, overrides: Sequence[str] = ()) -> float | None:
    """Run the stages of `cfg.pipeline` in order; returns the headline of the last.

    Raises
    ------
    Unsupported
        Lightning would have to start processes of its own in the middle.
    """
    _require_one_launcher(cfg)
    typed = [entry for entry in overrides if not entry.startswith("stage=")]
    headline = None
    for number, entry in enumerate(cfg.pipeline, start=1):
        words = [*_without(typed, entry), *entry]
        stage = compose("config", overrides=words)
        headline = run_stage(stage, words, place=f"{number}/{len(cfg.pipeline)}")
    return headline


def _without(typed: Sequence[str], entry: Sequence[str]) -> list[str]:
    """What was typed, but for the keys that a pipeline entry sets."""
    keys = {word.split("=", 1)[0] for word in entry}
    return [word for word in typed if word.split("=", 1)[0] not in keys]


def _require_one_launcher(cfg: DictConfig) -> None:
    several = str(cfg.trainer.get("strategy", "auto")).startswith("ddp")
    outside = "TORCHELASTIC_RUN_ID" in os.environ or "SLURM_JOB_ID" in os.environ
    if several and not outside:
        raise Unsupported(
            "stage=all: a trainer of several processes was found; they must exist before the "
            "first stage; run one stage at a time (stage=implicit trainer=ddp), or start with: "
            "torchrun --nproc-per-node N train.py ..."
        )


def run_stage(cfg: DictConfig, overrides: Sequence[str] = (), place: str = "") -> float | None:
    """Bring one stage to its end, from wherever its folder is; returns its headline metric.

    Raises
    ------
    MissingStage
        A stage that it reads is not finished.
    StaleRun
        Its folder holds results of other settings.
    OutputError
        Its folder cannot be written.
    """
    name = cfg.stage.name
    runs = runs_of(cfg, overrides)
    folder = runs.folder(name)
    inputs = {need: runs.open(need, needed_by=name) for need in cfg.stage.needs}
    settings = settings_of(cfg, inputs)
    announce(name, folder, place)
    with _output_errors(folder):
        state = _prepare(cfg, folder, settings)
        if state is Progress.ALL:
            say("      finished before, kept")
            return Run(folder).headline
        optional = {use: runs.find(use) for use in cfg.stage.get("optional", ())}
        inputs |= {use: found for use, found in optional.items() if found is not None}
        return _execute(cfg, folder, inputs, settings, state)


def runs_of(cfg: DictConfig, overrides: Sequence[str] = ()) -> Runs:
    """The folders that a configuration reads and writes."""
    words = [word for word in overrides if not word.startswith(("stage=", "force=", "debug="))]
    maps = {"parameterize": cfg.method.variant, "evaluate": cfg.method.variant}
    return Runs(
        root=Path(cfg.paths.runs),
        experiment=cfg.name,
        variant=cfg.ablation.name,
        shares={**maps, **cfg.ablation.shares},
        inputs=dict(cfg.inputs),
        command=" ".join(["python train.py", *(words or [f"experiment={cfg.name}"])]),
    )


def settings_of(cfg: DictConfig, inputs: Mapping[str, Run]) -> dict[str, Any]:
    """What decides the numbers: stage, data, seed, what was read; no machine, no path."""
    bare = cfg.copy()
    OmegaConf.set_struct(bare, False)
    bare.paths = {key: f"<{key}>" for key in cfg.paths}
    bare.workers = None
    trainer = OmegaConf.to_container(bare.trainer, resolve=True)
    return {
        "stage": OmegaConf.to_container(bare.stage, resolve=True),
        "data": _without_workers(OmegaConf.to_container(bare.data, resolve=True)),
        "trainer": {key: trainer.get(key) for key in _TRAINER_SCIENCE},
        "seed": cfg.seed,
        "inputs": {name: found.digest for name, found in inputs.items()},
    }


def _without_workers(node: Any) -> Any:
    if isinstance(node, dict):
        return {
            key: _without_workers(value)
            for key, value in node.items()
            if key not in ("workers", "num_workers")
        }
    return [_without_workers(value) for value in node] if isinstance(node, list) else node


def _prepare(cfg: DictConfig, folder: Path, settings: Mapping[str, Any]) -> Progress:
    """The restart rule, on a folder that rank zero alone may change."""
    if cfg.trainer.get("fast_dev_run"):
        return Progress.NOTHING
    first = rank_zero_only.rank == 0
    if cfg.force and first:
        clear(folder)
    state = Progress.NOTHING if cfg.force else restart(folder, settings)
    if state is Progress.NOTHING and first:
        begin(folder, settings)
        write_text(folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    return state


def _execute(
    cfg: DictConfig,
    folder: Path,
    inputs: Mapping[str, Run],
    settings: Mapping[str, Any],
    state: Progress,
) -> float | None:
    began = time.monotonic()
    _quiet()
    seed_everything(cfg.seed, workers=True, verbose=False)
    torch.set_num_threads(cfg.threads or _cores())
    data = instantiate(cfg.data, _partial_=True, _convert_="all")(inputs=inputs, folder=folder)
    module = instantiate(cfg.stage.module, _partial_=True, _convert_="all")(
        inputs=inputs, folder=folder
    )
    loggers = [
        instantiate(node, save_dir=str(folder)) for node in (cfg.logger or {}).values() if node
    ]
    trainer = _trainer(cfg, folder, loggers)
    for logger in loggers:
        logger.log_hyperparams(OmegaConf.to_container(cfg, resolve=True))
    try:
        _go(trainer, cfg.stage.verb, module, data, folder if state is Progress.SOME else None)
        if trainer.fast_dev_run:
            return None
        return _end(trainer, module, settings, inputs, began)
    finally:
        _close(loggers)


def _trainer(cfg: DictConfig, folder: Path, loggers: list[Any]) -> Trainer:
    callbacks = [instantiate(node) for node in (cfg.callbacks or {}).values() if node]
    return instantiate(
        cfg.trainer,
        callbacks=callbacks,
        logger=loggers or False,
        default_root_dir=str(folder),
        plugins=[WholeCheckpoints()],
    )


def _go(trainer: Trainer, verb: str, module: Stage, data: Any, begun: Path | None) -> None:
    if verb == "predict":
        trainer.predict(module, datamodule=data, return_predictions=False)
        return
    saved = begun / CHECKPOINT if begun else None
    found = saved is not None and saved.is_file()
    if found:
        say("      resumed from its last checkpoint")
    trainer.fit(module, datamodule=data, ckpt_path=str(saved) if found else None)


def _end(
    trainer: Trainer,
    module: Stage,
    settings: Mapping[str, Any],
    inputs: Mapping[str, Run],
    began: float,
) -> float | None:
    """Rank zero merges and seals; the others wait, so that they find the manifest."""
    trainer.strategy.barrier("verb")
    if trainer.is_global_zero:
        with torch.inference_mode(False):
            metrics = module.finish()
        seconds = round(time.monotonic() - began, 3)
        facts = {
            "inputs": {name: run.digest for name, run in inputs.items()},
            "seconds": seconds,
            "device": _device(trainer),
            "threads": torch.get_num_threads(),
            "ranks": trainer.world_size,
        }
        stage = settings["stage"]["name"]
        seal(module.folder, stage=stage, settings=settings, metrics=metrics, facts=facts)
        for logger in trainer.loggers:
            logger.log_metrics({f"end/{name}": value for name, value in metrics.items()})
        report(module.folder, metrics, seconds)
    trainer.strategy.barrier("seal")
    return Run(module.folder).headline


def _device(trainer: Trainer) -> str:
    root = trainer.strategy.root_device
    return torch.cuda.get_device_name(root) if root.type == "cuda" else root.type


def _cores() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, (cores or 1) // int(os.environ.get("LOCAL_WORLD_SIZE", "1")))


def _quiet() -> None:
    """Lightning's remarks on what is meant to be so here."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    remarks = (
        ".*does not have many workers.*",
        ".*`IterableDataset` has `__len__` defined.*",
        ".*smaller than the logging interval.*",
        ".*GPU available but not used.*",
        ".*Experiment logs directory .* exists and is not empty.*",
        ".*Checkpoint directory .* exists and is not empty.*",
        ".*Total length of .* is zero.*",
        ".*LeafSpec.*is deprecated.*",
    )
    for remark in remarks:
        warnings.filterwarnings("ignore", remark)


def _close(loggers: Sequence[Any]) -> None:
    failed = sys.exc_info()[0] is not None
    for logger in loggers:
        logger.finalize("failed" if failed else "success")
        finish = getattr(logger.experiment, "finish", None)
        if callable(finish):
            finish()


@contextmanager
def _output_errors(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL_OR_FORBIDDEN:
            raise
        raise OutputError(
            f"{error.filename or folder}: cannot be written ({error.strerror}); free space or "
            "permission is required; name another folder with paths.runs=FOLDER"
        ) from error


@contextmanager
def one_line_errors(*, sweep: bool) -> Iterator[None]:
    """Tell a GenSPError in one line: exit code 2, or a failed job that lets a sweep go on."""
    try:
        yield
    except GenSPError as error:
        if sweep:
            raise CompactHydraException(f"error: {error}") from None
        complain(error)
        raise SystemExit(2) from None
