"""One stage carried out by Lightning; imported when there is something to compute."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning import Trainer, seed_everything
from omegaconf import DictConfig, OmegaConf

from gensp.configuration import made, placed
from gensp.files import write_text
from gensp.machine import first_process
from gensp.restarts import Progress, begin
from gensp.runs import Run
from gensp.stages.callbacks import WholeCheckpoints
from gensp.stages.memory import forget_memory
from gensp.stages.session import (
    carry_out,
    close,
    conclude,
    environments,
    gather,
    quiet,
    threads,
    together,
)
from gensp.stages.speed import require_fast


def execute(
    cfg: DictConfig,
    folder: Path,
    inputs: Mapping[str, Run],
    settings: Mapping[str, Any],
    state: Progress,
) -> float | None:
    """Build data, module and trainer, run the stage's verb and seal its folder.

    Returns
    -------
    float or None
        The stage's headline metric; None where nothing is kept.
    """
    began = time.monotonic()
    if cfg.stage.verb == "fit":
        require_fast(cfg.trainer.precision, cfg.compile)
    forget_memory()
    quiet()
    seed_everything(cfg.seed, workers=True, verbose=False)
    torch.set_num_threads(cfg.threads or threads())
    trainer = _trainer(cfg, folder)
    with together(folder):
        gather(trainer)
    ours, own = placed(cfg), folder.absolute()
    read = {name: Run(run.folder.absolute()) for name, run in inputs.items()}
    data = made(ours.data, inputs=read, folder=own)
    module = made(ours.stage.module, inputs=read, folder=own)
    module.compiled = cfg.compile
    # After the inputs have proved good: a mistyped folder leaves no trace.
    _begin(cfg, folder, settings, state)
    trainer.loggers = [made(node, save_dir=str(folder)) for node in (cfg.logger or {}).values()]
    for logger in trainer.loggers:
        logger.log_hyperparams(OmegaConf.to_container(cfg, resolve=True))
    resumed = state is Progress.SOME
    try:
        with together(folder):
            carry_out(trainer, cfg.stage.verb, module, data, resume=resumed)
            if not cfg.keep:
                return None
            return conclude(
                trainer, module, settings=settings, inputs=inputs, began=began, resumed=resumed
            )
    finally:
        close(trainer.loggers)


def _begin(cfg: DictConfig, folder: Path, settings: Mapping[str, Any], state: Progress) -> None:
    if state is Progress.NOTHING and first_process():
        begin(folder, settings)
        write_text(folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))


def _trainer(cfg: DictConfig, folder: Path) -> Trainer:
    """Without loggers, which make folders."""
    callbacks = [made(node) for node in (cfg.callbacks or {}).values()]
    return made(
        cfg.trainer,
        callbacks=callbacks,
        logger=False,
        default_root_dir=str(folder),
        plugins=[WholeCheckpoints(), *environments()],
    )
