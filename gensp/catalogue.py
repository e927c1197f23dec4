"""Finished runs side by side: settings, versions, hardware, seconds, memory, what came out."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gensp.checksums import MANIFEST, totals
from gensp.errors import DamagedFile, MissingData, Unsupported
from gensp.files import read_json, write_text
from gensp.tables import markdown_table

# A stage's folder is at most this deep below the folder that is asked about.
_DEPTH = 3
_STAGES = (
    *("prepare", "augment", "implicit", "correspond", "initialize", "finetune"),
    *("parameterize", "evaluate"),
)
_NEEDED = {"stage", "digest", "metrics", "settings", "files"}
# Of the largest process; of all ranks and workers together; of the largest GPU.
MEMORY = ("peak_memory_gib", "peak_memory_sum_gib", "peak_gpu_memory_gib")
FACTS = (
    *("seconds", *MEMORY, "device", "threads", "ranks", "revision"),
    *("machine", "processor", "memory_gib"),
)


@dataclass(frozen=True)
class Entry:
    """One finished stage: its folder, its name below the folder asked about, its manifest."""

    folder: Path
    name: str
    manifest: Mapping[str, Any]

    @property
    def stage(self) -> str:
        """Name of the stage."""
        return str(self.manifest["stage"])

    @property
    def metrics(self) -> dict[str, float]:
        """What the stage ended with, the headline first."""
        return dict(self.manifest["metrics"])

    @property
    def facts(self) -> dict[str, Any]:
        """How the run went and what computed it; what its manifest does not tell is left out."""
        known = {key: self.manifest[key] for key in FACTS if self.manifest.get(key) is not None}
        if self.manifest.get("resumed"):
            # Only the last of several sessions was timed.
            known["seconds"] = f"{known['seconds']} (resumed)"
        versions = self.manifest.get("versions") or {}
        return known | {f"version of {name}": value for name, value in versions.items() if value}

    @property
    def settings(self) -> dict[str, Any]:
        """The scientific configuration, one key a number: `data.task.seed`."""
        return flat(self.manifest["settings"])

    @property
    def files(self) -> int:
        """How many files the stage left."""
        return totals(self.folder, self.manifest["files"])[0]

    @property
    def size(self) -> int:
        """Bytes of all of them."""
        return totals(self.folder, self.manifest["files"])[1]


def flat(node: Any, key: str = "") -> dict[str, Any]:
    """Nested settings as one level, keys joined by dots, places of lists by numbers."""
    if isinstance(node, Mapping):
        pairs: Iterable[tuple[Any, Any]] = node.items()
    elif isinstance(node, list):
        pairs = enumerate(node)
    else:
        return {key: node}
    return {
        name: value
        for part, entry in pairs
        for name, value in flat(entry, f"{key}.{part}" if key else str(part)).items()
    }


def find_runs(root: Path) -> list[Entry]:
    """All finished stages in a folder: of a stage, a variant, an experiment or of many.

    Raises
    ------
    MissingData
        There is none, or a manifest is damaged.
    """
    found = [path for depth in range(_DEPTH + 1) for path in root.glob("*/" * depth + MANIFEST)]
    if not found:
        raise MissingData(
            f"{root}: holds no finished stage; a folder with {MANIFEST} in it, or in folders "
            "below, is required; name a folder of runs, such as runs/quickstart"
        )
    entries = [_entry(path, root) for path in found]
    return sorted(entries, key=lambda entry: (entry.folder.parent, _place(entry)))


def _entry(path: Path, root: Path) -> Entry:
    try:
        manifest = read_json(path)
        lacking = _NEEDED - manifest.keys()
    except (OSError, DamagedFile, AttributeError) as error:
        raise MissingData(_damaged(path, f"cannot be read ({type(error).__name__})")) from error
    if lacking:
        raise MissingData(_damaged(path, f"has no {min(lacking)}"))
    name = path.parent.relative_to(root).as_posix()
    return Entry(path.parent, path.parent.name if name == "." else name, manifest)


def _damaged(path: Path, found: str) -> str:
    return (
        f"{path}: {found}; the manifest of a finished stage is required; make the stage anew with "
        "force=true, or remove its folder"
    )


def _place(entry: Entry) -> int:
    return _STAGES.index(entry.stage) if entry.stage in _STAGES else len(_STAGES)


LISTED = ("run", "headline", "seconds", "GiB", "versions", "revision", "machine")


def listed(entries: Sequence[Entry]) -> list[list[str]]:
    """A row of every run, under `LISTED`."""
    return [
        [
            entry.name,
            _headline(entry.metrics),
            text(entry.facts.get("seconds")),
            text(entry.facts.get("peak_memory_gib")),
            f"gensp {text(entry.facts.get('version of gensp'))}",
            text(entry.facts.get("revision")),
            text(entry.facts.get("machine")),
        ]
        for entry in entries
    ]


def _headline(metrics: Mapping[str, float]) -> str:
    return next((f"{name} {text(value)}" for name, value in metrics.items()), "–")


def text(value: Any) -> str:
    """A value as a table shows it."""
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def compared(columns: Sequence[Sequence[Entry]]) -> list[list[str]]:
    """What differs between runs: rows of stage, key, and a value for every column.

    Settings, versions, revision, hardware and metrics are listed where they differ, seconds and
    memory always. A stage that only some of the columns have is compared among them.

    Raises
    ------
    Unsupported
        Fewer than two columns, or no stage that two of them have.
    """
    if len(columns) < 2:
        raise Unsupported("compare: one run was found; two or more are required; name another")
    by_stage = [{entry.stage: entry for entry in column} for column in columns]
    stages = list(dict.fromkeys(entry.stage for column in columns for entry in column))
    shared = [stage for stage in stages if sum(stage in known for known in by_stage) > 1]
    if not shared:
        raise Unsupported(
            f"compare: the runs share no stage, but have {', '.join(stages)}; a stage that two "
            "have is required; name their variants or experiments"
        )
    return [row for stage in shared for row in _differing(stage, [k.get(stage) for k in by_stage])]


def _differing(stage: str, entries: Sequence[Entry | None]) -> list[list[str]]:
    tables = [
        {} if entry is None else {**entry.settings, **entry.facts, **entry.metrics}
        for entry in entries
    ]
    there = [table for table, entry in zip(tables, entries, strict=True) if entry is not None]
    keys = dict.fromkeys(key for table in tables for key in table)
    always = {"seconds", *MEMORY}
    return [
        [stage, key, *(text(table.get(key)) for table in tables)]
        for key in keys
        if key in always or any(table.get(key) != there[0].get(key) for table in there)
    ]


def export(entries: Sequence[Entry], path: Path) -> None:
    """Write all runs with settings, facts and metrics as csv, json or md, by the suffix.

    Raises
    ------
    Unsupported
        Another suffix.
    """
    rows = [_row(entry) for entry in entries]
    if path.suffix == ".json":
        write_text(path, json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
    elif path.suffix == ".csv":
        write_text(path, _csv(rows))
    elif path.suffix == ".md":
        write_text(path, markdown_table(LISTED, listed(entries)))
    else:
        raise Unsupported(
            f"{path}: format '{path.suffix}' is not written; one of .csv, .json, .md is required; "
            "name another file"
        )


def _row(entry: Entry) -> dict[str, Any]:
    metrics = {f"metric.{name}": value for name, value in entry.metrics.items()}
    settings = {f"setting.{name}": value for name, value in entry.settings.items()}
    known = {"run": entry.name, "stage": entry.stage, "bytes": entry.size}
    return {**known, **entry.facts, **metrics, **settings}


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()
