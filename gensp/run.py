"""From a configuration to a finished stage, with the rules of restarting."""

import errno
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose
from omegaconf import DictConfig

from gensp.checksums import require_intact
from gensp.configuration import (
    require_name,
    require_numbers,
    require_taken,
    require_values,
    runs_of,
    settings_of,
)
from gensp.data.raw import require_apart, require_rule
from gensp.errors import OutputError, Unsupported
from gensp.files import unwritable
from gensp.machine import first_process
from gensp.occupancy import occupied
from gensp.ranks import require_startable
from gensp.restarts import Progress, clear, require_own, restart, tidy
from gensp.runs import Run, Runs
from gensp.sweeps import named
from gensp.terminal import announce, say, show_methods, show_variants

_FULL_OR_FORBIDDEN = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM),
    errno.ENOTDIR,
}


def run(cfg: DictConfig, overrides: Sequence[str] = (), *, sweep: bool = False) -> float | None:
    """Run the stage that the configuration names, or the whole pipeline.

    Parameters
    ----------
    overrides
        What was typed to get `cfg`; a pipeline composes its stages from it.
    sweep
        Whether this is one job of several.

    Raises
    ------
    Unsupported
        A fit or a refinement was typed that the method does not take, or Lightning would have to
        start processes of its own where it cannot.
    """
    require_taken(cfg, overrides)
    require_numbers(cfg)
    require_startable(cfg.trainer, stage=cfg.stage.name, sweep=sweep)
    require_rule(cfg.stage.name, cfg.shapes.get("on_bad"))
    if cfg.stage.name == "prepare":
        require_apart(cfg.prepare.out, cfg.shapes.get("root"))
    if cfg.stage.name == "all":
        return run_pipeline(cfg, overrides, sweep=sweep)
    return run_stage(cfg, overrides)


def run_pipeline(
    cfg: DictConfig, overrides: Sequence[str] = (), *, sweep: bool = False
) -> float | None:
    """Run the stages of `cfg.pipeline` in order; returns the headline of the last.

    Raises
    ------
    Unsupported
        As of `run`, for any of the stages, before the first is begun.
    """
    if not cfg.keep:
        raise Unsupported(
            "keep: is false, as by debug=fast, so that no stage of a pipeline finds what the one "
            "before it made; one stage is required; add stage=NAME, and run those that it reads "
            "before, with keep=true"
        )
    typed = [entry for entry in overrides if not entry.startswith("stage=")]
    composed = [[*_without(typed, entry), *entry] for entry in cfg.pipeline]
    stages = [compose("config", overrides=words) for words in composed]
    for stage in stages:
        require_startable(stage.trainer, stage=cfg.stage.name, sweep=sweep)
    headline = None
    for number, (stage, words) in enumerate(zip(stages, composed, strict=True), start=1):
        headline = run_stage(stage, words, place=f"{number}/{len(stages)}")
    show_variants(Path(cfg.paths.runs) / cfg.name)
    return headline


def _without(typed: Sequence[str], entry: Sequence[str]) -> list[str]:
    """What was typed, but for the keys that a pipeline entry sets."""
    keys = {word.split("=", 1)[0] for word in entry}
    return [word for word in typed if word.split("=", 1)[0] not in keys]


def run_stage(cfg: DictConfig, overrides: Sequence[str] = (), place: str = "") -> float | None:
    """Bring one stage to its end, from wherever its folder is; returns its headline metric.

    Raises
    ------
    MissingStage
        A stage that it reads is not finished.
    StaleRun
        Its folder holds results of other settings, or what it reads was damaged since.
    RunInUse
        Another process works in its folder.
    OutputError
        Its folder cannot be written.
    """
    require_values(cfg)
    name = cfg.stage.name
    runs = runs_of(cfg, overrides)
    cfg = named(cfg, runs.variant_of(name))
    folder = runs.folder(name)
    inputs = {need: runs.open(need, needed_by=name) for need in cfg.stage.needs}
    settings = settings_of(cfg, inputs)
    if runs.outputs.get(name):
        require_own(folder, name)
    elif cfg.keep:
        require_name(cfg, overrides)
    announce(name, folder, place)
    with _output_errors(cfg, folder):
        headline = _bring_to_end(cfg, folder, runs, inputs, settings)
        if name == "evaluate" and cfg.keep:
            show_methods(folder.parent.parent)
    return headline


def _bring_to_end(
    cfg: DictConfig, folder: Path, runs: Runs, inputs: dict[str, Run], settings: dict[str, Any]
) -> float | None:
    if cfg.keep and not cfg.force and restart(folder, settings) is Progress.ALL:
        say("      finished before, kept")
        return Run(folder).headline
    with _place(cfg, folder) as place, occupied(place):
        state = _prepare(cfg, place, settings)
        if state is Progress.ALL:  # by another process, since
            return Run(place).headline
        optional = {use: runs.find(use) for use in cfg.stage.get("optional", ())}
        read = inputs | {use: run for use, run in optional.items() if run is not None}
        if first_process():  # the others wait in `gather`
            for stage, run in read.items():
                require_intact(run.folder, run.files(), stage)
        # Imported late: what is wrong before is told without waiting for torch.
        from gensp.execution import execute

        return execute(cfg, place, read, settings, state)


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
    if cfg.force and first_process():
        clear(folder)
    state = Progress.NOTHING if cfg.force else restart(folder, settings)
    if state is Progress.SOME and first_process():
        tidy(folder)
    return state


@contextmanager
def _output_errors(cfg: DictConfig, folder: Path) -> Iterator[None]:
    """One line for what cannot be written, with the setting that names another place for it."""
    try:
        yield
    except OutputError as error:
        path = Path(str(error).partition(": ")[0])
        raise OutputError(str(error).replace("paths.runs=", f"{_word(cfg, path)}=")) from error
    except OSError as error:
        if error.errno not in _FULL_OR_FORBIDDEN:
            raise
        path = Path(error.filename or folder)
        raise unwritable(path, error, _word(cfg, path)) from error


def _word(cfg: DictConfig, path: Path) -> str:
    """The setting that says where a path of a run lies."""
    places = {"paths.cache": cfg.paths.cache, "prepare.out": cfg.prepare.out}
    within = [
        word
        for word, place in places.items()
        if place is not None and path.absolute().is_relative_to(Path(place).absolute())
    ]
    return within[0] if within else "paths.runs"
