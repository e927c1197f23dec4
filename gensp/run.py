"""From a configuration to a finished stage; the only module that makes objects from it."""

import errno
import os
import re
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from hydra import compose
from hydra.errors import CompactHydraException, InstantiationException
from hydra.utils import instantiate
from lightning import Trainer, seed_everything
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError

from gensp.data.raw import require_apart, require_rule
from gensp.errors import GenSPError, MissingData, OutputError, Unsupported
from gensp.files import write_text
from gensp.machine import forget_peak_memory
from gensp.runs import Progress, Run, Runs, begin, clear, require_own, restart, tidy
from gensp.stages.callbacks import WholeCheckpoints
from gensp.stages.session import carry_out, close, conclude, quiet, threads
from gensp.terminal import announce, complain, say, show_methods, show_variants

_TRAINER_SCIENCE = (
    "max_epochs",
    "max_steps",
    "precision",
    "accumulate_grad_batches",
    "gradient_clip_val",
    "limit_train_batches",
    "overfit_batches",
    "fast_dev_run",
)
_FULL_OR_FORBIDDEN = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM),
    errno.ENOTDIR,
}


def run(cfg: DictConfig, overrides: Sequence[str] = ()) -> float | None:
    """Run the stage that the configuration names, or the whole pipeline.

    Parameters
    ----------
    overrides
        What was typed to get `cfg`; a pipeline composes its stages from it.

    Raises
    ------
    Unsupported
        A fit or a refinement was typed that the method does not take.
    """
    _require_taken(cfg, overrides)
    require_rule(cfg.stage.name, cfg.shapes.get("on_bad"))
    if cfg.stage.name == "prepare":
        require_apart(cfg.prepare.out, cfg.shapes.get("root"))
    if cfg.stage.name == "all":
        return run_pipeline(cfg, overrides)
    return run_stage(cfg, overrides)


def _require_taken(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Refuse what was asked for and would be ignored."""
    method = cfg.method.name
    for part in ("fit", "refine"):
        typed = [word for word in overrides if re.match(rf"\+*{part}[.=]", word)]
        if typed and part not in cfg.method.takes:
            takes = (
                ", ".join(f"{word}=" for word in cfg.method.takes) or "neither fit= nor refine="
            )
            raise Unsupported(
                f"{typed[0]}: was found with method={method}, which takes {takes}; leave it out, "
                f"or choose method=gensp"
            )


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
    show_variants(Path(cfg.paths.runs) / cfg.name)
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
    _require_values(cfg)
    name = cfg.stage.name
    runs = runs_of(cfg, overrides)
    folder = runs.folder(name)
    inputs = {need: runs.open(need, needed_by=name) for need in cfg.stage.needs}
    settings = settings_of(cfg, inputs)
    if runs.outputs.get(name):
        require_own(folder, name)
    announce(name, folder, place)
    with _output_errors(folder):
        headline = _bring_to_end(cfg, folder, runs, inputs, settings)
        if name == "evaluate" and cfg.keep:
            show_methods(folder.parent.parent)
    return headline


def _bring_to_end(
    cfg: DictConfig, folder: Path, runs: Runs, inputs: dict[str, Run], settings: dict[str, Any]
) -> float | None:
    with _place(cfg, folder) as place:
        state = _prepare(cfg, place, settings)
        if state is Progress.ALL:
            say("      finished before, kept")
            return Run(place).headline
        optional = {use: runs.find(use) for use in cfg.stage.get("optional", ())}
        found = {use: run for use, run in optional.items() if run is not None}
        return _execute(cfg, place, inputs | found, settings, state)


def _require_values(cfg: DictConfig) -> None:
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
    except InterpolationKeyError as error:
        raise Unsupported(_unknown_word(cfg, str(error))) from None
    if missing:
        raise MissingData(
            f"{', '.join(missing)}: no value was given; one is required; add {missing[0]}=VALUE"
        )


def _unknown_word(cfg: DictConfig, complaint: str) -> str:
    """What to tell when a key holds a word that a table of the configuration does not have."""
    found = re.search(r"'([^']+)' not found", complaint)
    words = found.group(1).split(".") if found else []
    for place, word in enumerate(words):
        table = ".".join(words[:place])
        known = OmegaConf.select(cfg, table) if table else cfg
        if word not in known:
            return f"{table}: has no '{word}'; one of {', '.join(map(str, known))} is required"
    return complaint.splitlines()[0]


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
        outputs={"prepare": cfg.prepare.out},
        command=" ".join(["python train.py", *(words or [f"experiment={cfg.name}"])]),
    )


def settings_of(cfg: DictConfig, inputs: Mapping[str, Run]) -> dict[str, Any]:
    """What decides the numbers: stage, data, seed, what was read; no machine, no path."""
    bare = cfg.copy()
    OmegaConf.set_struct(bare, False)
    bare.paths = {key: f"<{key}>" for key in cfg.paths}
    bare.workers = None
    trainer = OmegaConf.to_container(bare.trainer, resolve=True)
    # Only stages whose work names the collection read its files; the others see it by `inputs`.
    reads = "collection" in (cfg.data.get("task") or {})
    return {
        "stage": OmegaConf.to_container(bare.stage, resolve=True),
        "data": _without_workers(OmegaConf.to_container(bare.data, resolve=True)),
        "trainer": {key: trainer.get(key) for key in _TRAINER_SCIENCE},
        "seed": cfg.seed,
        "shapes": _made(cfg.shapes).fingerprint if reads else None,
        "inputs": {name: found.outputs for name, found in inputs.items()},
    }


def _without_workers(node: Any) -> Any:
    if isinstance(node, dict):
        return {
            key: _without_workers(value)
            for key, value in node.items()
            if key not in ("workers", "num_workers")
        }
    return [_without_workers(value) for value in node] if isinstance(node, list) else node


@contextmanager
def _place(cfg: DictConfig, folder: Path) -> Iterator[Path]:
    """The stage's folder, or with keep=false one that is thrown away."""
    if cfg.keep:
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="gensp-") as scratch:
        yield Path(scratch)


def _prepare(cfg: DictConfig, folder: Path, settings: Mapping[str, Any]) -> Progress:
    """The restart rule, on a folder that rank zero alone may change."""
    if not cfg.keep:
        return Progress.NOTHING
    if cfg.force and rank_zero_only.rank == 0:
        clear(folder)
    state = Progress.NOTHING if cfg.force else restart(folder, settings)
    if state is Progress.SOME and rank_zero_only.rank == 0:
        tidy(folder)
    return state


def _execute(
    cfg: DictConfig,
    folder: Path,
    inputs: Mapping[str, Run],
    settings: Mapping[str, Any],
    state: Progress,
) -> float | None:
    began = time.monotonic()
    forget_peak_memory()
    quiet()
    seed_everything(cfg.seed, workers=True, verbose=False)
    torch.set_num_threads(cfg.threads or threads())
    data = _made(cfg.data, inputs=inputs, folder=folder)
    module = _made(cfg.stage.module, inputs=inputs, folder=folder)
    # After the inputs have proved good: a mistyped folder leaves no trace.
    _begin(cfg, folder, settings, state)
    loggers = [_made(node, save_dir=str(folder)) for node in (cfg.logger or {}).values()]
    trainer = _trainer(cfg, folder, loggers)
    for logger in loggers:
        logger.log_hyperparams(OmegaConf.to_container(cfg, resolve=True))
    resumed = state is Progress.SOME
    try:
        carry_out(trainer, cfg.stage.verb, module, data, resume=resumed)
        if not cfg.keep:
            return None
        return conclude(
            trainer, module, settings=settings, inputs=inputs, began=began, resumed=resumed
        )
    finally:
        close(loggers)


def _begin(cfg: DictConfig, folder: Path, settings: Mapping[str, Any], state: Progress) -> None:
    if state is Progress.NOTHING and rank_zero_only.rank == 0:
        begin(folder, settings)
        write_text(folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))


def _made(node: DictConfig, **given: Any) -> Any:
    """The object that a node of the configuration describes; its own errors come out bare."""
    try:
        return instantiate(node, _partial_=True, _convert_="all")(**given)
    except InstantiationException as error:
        if isinstance(error.__cause__, GenSPError | OSError):
            raise error.__cause__ from None
        raise


def _trainer(cfg: DictConfig, folder: Path, loggers: list[Any]) -> Trainer:
    callbacks = [_made(node) for node in (cfg.callbacks or {}).values()]
    return _made(
        cfg.trainer,
        callbacks=callbacks,
        logger=loggers or False,
        default_root_dir=str(folder),
        plugins=[WholeCheckpoints()],
    )


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
