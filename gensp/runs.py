"""Run folders: where a stage's results are, whether they are whole, and what they were made with.

`runs/<experiment>/<variant>/<stage>/` is complete when it holds `manifest.json`, which is
written last and seals `files.csv`, the list of its files. `settings.json` is written first, so
that an interrupted run can be told from a run of other settings: see `gensp.restarts`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from gensp.checksums import LOGGED, MANIFEST, Listed, digest_of, listed, write_list
from gensp.errors import DamagedFile, MissingStage
from gensp.files import content_hash, read_json, write_json
from gensp.machine import environment, peak_memory

SETTINGS = "settings.json"
CHECKPOINT = Path("checkpoints") / "last.ckpt"
LOCK = ".lock"  # hidden, so no result

# How a run went, not what it found: times and paths, which differ from run to run.
_ACCOUNTS = {SETTINGS, "config.yaml", "rows", "checkpoints", *LOGGED}


@dataclass(frozen=True)
class Run:
    """The folder of a finished stage."""

    folder: Path

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What the stage left when it was sealed."""
        return record(self.folder / MANIFEST, {"settings", "digest", "metrics", "files"})

    @property
    def complete(self) -> bool:
        """Whether the stage was finished."""
        return (self.folder / MANIFEST).is_file()

    @property
    def digest(self) -> str:
        """The digest of the settings, those of all stages before included."""
        return str(self.manifest["digest"])

    def files(self) -> Iterator[Listed]:
        """What the stage had left when it was sealed, one file after another, by name.

        Raises
        ------
        DamagedFile
            The list of files is missing or was changed.
        """
        return listed(self.folder, self.manifest["files"])

    @cached_property
    def outputs(self) -> str:
        """A digest of what the stage made: equal results give equal digests, however made.

        Tables (csv), rows, logs and checkpoints tell how long it took and do not count.
        """
        return digest_of(entry for entry in self.files() if _is_result(entry.file))

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


def seal(
    folder: Path,
    *,
    stage: str,
    settings: Mapping[str, Any],
    metrics: Mapping[str, float],
    facts: Mapping[str, Any],
) -> Run:
    """Write the list of files, then the manifest, which makes the run complete.

    Parameters
    ----------
    settings
        The scientific configuration, with the digests of the runs it read.
    metrics
        Numbers the stage ended with, the headline first.
    facts
        Whatever else should be remembered: seconds, hardware, memory of other processes.
    """
    manifest = {
        "stage": stage,
        "digest": content_hash(plain(settings)),
        "metrics": dict(metrics),
        "peak_memory_gib": round(peak_memory(), 3),
        **facts,
        **environment(),
        "settings": plain(settings),
        "files": write_list(folder),
    }
    write_json(folder / MANIFEST, manifest)
    return Run(folder)


def record(path: Path, needed: set[str]) -> dict[str, Any]:
    """A manifest, or the settings of a run that is not finished.

    Raises
    ------
    DamagedFile
        It lacks one of the entries.
    """
    found = read_json(path)
    if not isinstance(found, dict) or needed - found.keys() or not _all_tables(found, needed):
        raise DamagedFile(
            f"{path}: is damaged (no {', '.join(sorted(needed))}); the record of a stage is "
            "required; restore it, or make the stage anew with force=true"
        )
    return found


def _all_tables(found: Mapping[str, Any], needed: set[str]) -> bool:
    return all(isinstance(found[name], dict) for name in needed - {"digest"})


def plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings as JSON gives them back, so that both sides of a comparison agree."""

    def bare(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(name): bare(entry) for name, entry in value.items()}
        if isinstance(value, list | tuple):
            return [bare(entry) for entry in value]
        return str(value) if isinstance(value, Path) else value

    return {str(name): bare(entry) for name, entry in settings.items()}


def _is_result(name: str) -> bool:
    return not _ACCOUNTS & set(name.split("/")) and not name.endswith(".csv")
