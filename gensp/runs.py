"""Run folders: where a stage's results are, whether they are whole, and what they were made with.

`runs/<experiment>/<variant>/<stage>/` is complete when it holds `manifest.json`, which is
written last. `settings.json` is written first, so that an interrupted run can be told from a
run of other settings.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

from gensp.checksums import LOGGED, MANIFEST, listing
from gensp.errors import DamagedFile, MissingStage, OutputError, StaleRun
from gensp.files import content_hash, read_json, write_json
from gensp.machine import environment, peak_memory

SETTINGS = "settings.json"
CHECKPOINT = Path("checkpoints") / "last.ckpt"

# How a run went, not what it found: times and paths, which differ from run to run.
_ACCOUNTS = {SETTINGS, "config.yaml", "rows", "checkpoints", *LOGGED}


@dataclass(frozen=True)
class Run:
    """The folder of a finished stage."""

    folder: Path

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What the stage left when it was sealed."""
        return _record(self.folder / MANIFEST, {"settings", "digest", "metrics", "files"})

    @property
    def complete(self) -> bool:
        """Whether the stage was finished."""
        return (self.folder / MANIFEST).is_file()

    @property
    def digest(self) -> str:
        """The digest of the settings, those of all stages before included."""
        return str(self.manifest["digest"])

    @property
    def outputs(self) -> str:
        """A digest of what the stage made: equal results give equal digests, however made.

        Tables (csv), rows, logs and checkpoints tell how long it took and do not count.
        """
        hashes = {name: entry["sha256"] for name, entry in self.manifest["files"].items()}
        return content_hash({name: hashes[name] for name in hashes if _is_result(name)})

    @property
    def metrics(self) -> dict[str, float]:
        """The numbers the stage ended with; the first is its headline."""
        return dict(self.manifest["metrics"])

    @property
    def headline(self) -> float | None:
        """The first metric."""
        return next(iter(self.metrics.values()), None)


@dataclass(frozen=True)
class Runs:
    """The run folders of one experiment, seen from one variant.

    Parameters
    ----------
    root, experiment, variant
        Give `root/experiment/variant/<stage>`.
    shares
        Stages whose folder belongs to another variant: stage → variant.
    inputs
        Folders given by hand, in place of a stage's own: stage → folder or None.
    outputs
        Folders given by hand for a stage to write into: stage → folder or None.
    command
        What to type, without the stage, to make a missing one.
    """

    root: Path
    experiment: str
    variant: str
    shares: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str | None] = field(default_factory=dict)
    outputs: Mapping[str, str | None] = field(default_factory=dict)
    command: str = "python train.py"

    def folder(self, stage: str) -> Path:
        """Where a stage writes."""
        given = self.outputs.get(stage)
        if given:
            return Path(given)
        return Path(self.root) / self.experiment / self.variant_of(stage) / stage

    def variant_of(self, stage: str) -> str:
        """The variant that a stage's folder belongs to, with what a sweep adds to its name."""
        return self.shares.get(stage, self.variant)

    def open(self, stage: str, *, needed_by: str) -> Run:
        """The finished run of a stage.

        Raises
        ------
        MissingStage
            It has no manifest; the message names the command that makes it.
        """
        run = self.find(stage)
        if run is None:
            raise MissingStage(
                f"'{needed_by}' needs '{stage}', but {self._place(stage)} has no {MANIFEST}; "
                f"run: {self.command} stage={stage}"
            )
        return run

    def find(self, stage: str) -> Run | None:
        """The finished run of a stage, or None."""
        run = Run(self._place(stage))
        return run if run.complete else None

    def _place(self, stage: str) -> Path:
        given = self.inputs.get(stage)
        return Path(given) if given else self.folder(stage)


class Progress(Enum):
    """What a folder holds of the run that is asked for."""

    NOTHING = "nothing"
    SOME = "some"
    ALL = "all"


def restart(folder: Path, settings: Mapping[str, Any]) -> Progress:
    """How far a run of these settings has come in this folder.

    Parameters
    ----------
    settings
        Its entry `inputs` holds the digests of the results that the run reads, by stage.

    Raises
    ------
    StaleRun
        The folder holds a run, finished or not, of other settings or of other inputs.
    """
    sealed = folder / MANIFEST
    found = sealed if sealed.is_file() else folder / SETTINGS
    if not found.is_file():
        return Progress.NOTHING
    stored, asked = dict(_record(found, {"settings"})["settings"]), _plain(settings)
    before, now = stored.pop("inputs", None) or {}, asked.pop("inputs", None) or {}
    changed = differences(stored, asked)
    if changed:
        listed = "; ".join(changed[:6]) + (f"; and {len(changed) - 6} more" * (len(changed) > 6))
        raise StaleRun(
            f"{folder}: made with other settings ({listed}); the same settings are required to go "
            "on; add force=true to make it anew, or name=NEW to keep both"
        )
    remade = [stage for stage in sorted({*before, *now}) if before.get(stage) != now.get(stage)]
    if remade:
        raise StaleRun(
            f"{folder}: made from other results of stage {', '.join(remade)} than there are now; "
            "a stage and what it reads must belong together; make it anew from them with "
            f"stage={asked['stage']['name']} force=true, or name=NEW to keep both"
        )
    return Progress.ALL if found is sealed else Progress.SOME


def _record(path: Path, needed: set[str]) -> dict[str, Any]:
    """A manifest, or the settings of a run that is not finished."""
    found = read_json(path)
    if not isinstance(found, dict) or needed - found.keys() or not _all_tables(found, needed):
        raise DamagedFile(
            f"{path}: is damaged (no {', '.join(sorted(needed))}); the record of a stage is "
            "required; restore it, or make the stage anew with force=true"
        )
    return found


def _all_tables(found: Mapping[str, Any], needed: set[str]) -> bool:
    return all(isinstance(found[name], dict) for name in needed - {"digest"})


def require_own(folder: Path, stage: str) -> None:
    """Refuse to write into a folder that holds something else than this stage's results.

    Raises
    ------
    OutputError
        It is a file, or holds files that no run of the stage has left.
    """
    if folder.is_dir() and any(folder.iterdir()):
        notes = [path for path in (folder / MANIFEST, folder / SETTINGS) if path.is_file()]
        found = _record(notes[0], {"settings"})["settings"] if notes else {}
        if (found.get("stage") or {}).get("name") == stage:
            return
    elif not folder.exists() or folder.is_dir():
        return
    raise OutputError(
        f"{folder}: is not empty and was not written by stage={stage}; a folder of its own is "
        "required, because it may be cleared; name one that does not exist yet"
    )


def begin(folder: Path, settings: Mapping[str, Any]) -> None:
    """Note what a run is made with, before its first result."""
    write_json(folder / SETTINGS, {"settings": _plain(settings)})


def tidy(folder: Path) -> None:
    """Remove the halves of files that a killed run left; see `gensp.files.atomic_path`."""
    for path in folder.rglob(".*-*"):
        if path.is_file():
            path.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Empty a run's folder; its seal first, so that a half-removed run never looks finished.

    The folder itself stays: whoever holds its lock keeps holding it.
    """
    (folder / MANIFEST).unlink(missing_ok=True)
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def seal(
    folder: Path,
    *,
    stage: str,
    settings: Mapping[str, Any],
    metrics: Mapping[str, float],
    facts: Mapping[str, Any],
) -> Run:
    """Write the manifest, which makes the run complete.

    Parameters
    ----------
    settings
        The scientific configuration, with the digests of the runs it read.
    metrics
        Numbers the stage ended with, the headline first.
    facts
        Whatever else should be remembered: seconds, hardware.
    """
    manifest = {
        "stage": stage,
        "digest": content_hash(_plain(settings)),
        "metrics": dict(metrics),
        **facts,
        "peak_memory_gib": round(peak_memory(), 3),
        **environment(),
        "settings": _plain(settings),
        "files": listing(folder),
    }
    write_json(folder / MANIFEST, manifest)
    return Run(folder)


def differences(old: Any, new: Any, key: str = "") -> list[str]:
    """Which entries of two nested settings differ, as "key: old → new"."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = [*old, *(name for name in new if name not in old)]
        pairs = ((name, old.get(name), new.get(name)) for name in names)
        return [
            line
            for name, a, b in pairs
            for line in differences(a, b, f"{key}.{name}" if key else str(name))
        ]
    return [] if old == new else [f"{key}: {_short(old)} → {_short(new)}"]


def _short(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings as JSON gives them back, so that both sides of a comparison agree."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(name): plain(entry) for name, entry in value.items()}
        if isinstance(value, list | tuple):
            return [plain(entry) for entry in value]
        return str(value) if isinstance(value, Path) else value

    return {str(name): plain(entry) for name, entry in settings.items()}


def _is_result(name: str) -> bool:
    return not _ACCOUNTS & set(name.split("/")) and not name.endswith(".csv")
