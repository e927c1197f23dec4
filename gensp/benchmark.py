"""Methods side by side: distortion, consistency, bijectivity, run time (paper Table 1)."""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gensp.columns import PARTS, Column, Part
from gensp.tables import Summary, cell, latex_table, markdown_table, summary_label

_SEED = re.compile(r"\+seed-\d+")


def best_baselines(summaries: Iterable[Summary], count: int) -> list[Summary]:
    """The methods that learn nothing, fold nothing and fail on nothing, the best of them first.

    By the error without rotation over all shapes; where there is no ground truth by mean σ.
    """
    sound = [
        summary
        for summary in summaries
        if summary["method"] != "gensp"
        and not summary.get("failed")
        and summary["groups"].get("all", {}).get("affected_shapes") == 0
    ]
    return sorted(sound, key=lambda summary: _rank(summary["groups"]["all"]))[:count]


def _rank(group: Mapping[str, Any]) -> tuple[float, float]:
    error, sigma = group.get("error"), group.get("sigma_mean")
    return (math.inf if error is None else error, math.inf if sigma is None else sigma)


@dataclass(frozen=True)
class Row:
    """One method and split: the figures of every seed that was run."""

    label: str
    groups: tuple[dict[str, float], ...]
    learnt: bool = False

    def mean(self, key: str) -> float | None:
        """A figure's mean over the seeds; none where there is no figure."""
        values = [group[key] for group in self.groups if key in group]
        return float(np.mean(values)) if values else None

    def cell(self, column: Column) -> str:
        """The figure, or the mean over seeds with their standard deviation."""
        values = [group[column.key] for group in self.groups if column.key in group]
        if len(values) < 2:
            return cell(values[0] if values else None, column.digits)
        mean, spread = float(np.mean(values)), float(np.std(values, ddof=1))
        told = cell(mean, column.digits)
        return told if spread == 0 else f"{told} ± {cell(spread, column.digits)}"


@dataclass(frozen=True)
class Benchmark:
    """The tables of several evaluations of one collection.

    All shapes count alike for methods that learn nothing; where one learns, shapes that it has
    seen and those that it has not are groups of their own. Evaluations that differ by their seed
    alone are one row.
    """

    summaries: tuple[Summary, ...]

    @property
    def splits(self) -> tuple[str, ...]:
        """The groups of shapes that are shown."""
        learnt = any(summary["method"] == "gensp" for summary in self.summaries)
        return ("test", "train", "all") if learnt else ("all",)

    def markdown(self) -> str:
        """A table for every part and split, the meaning of the columns, what failed and why."""
        lines = [f"# {self.summaries[0].get('collection', '')}: methods side by side", ""]
        for part, tables in self._parts():
            for split, columns, rows in tables:
                header = ["method", *(column.heading for column in columns)]
                lines += [f"## {part.title}, {split} shapes", "", markdown_table(header, rows)]
            lines += [f"- **{column.heading}**: {column.meaning}" for column in tables[0][1]]
            lines.append("")
        return "\n".join([*lines, *self._failures()]).rstrip() + "\n"

    def _failures(self) -> Iterator[str]:
        failed = [(s, entry) for s in self.summaries for entry in s.get("failed") or ()]
        if failed:
            yield "## Failures\n"
        for summary, entry in failed:
            id, error = entry["id"], str(entry["error"])
            yield f"- {summary_label(summary)}, {id}: {error.removeprefix(f'{id}: ')}"

    def latex(self) -> str:
        """The tables as LaTeX tabulars, for a document that loads booktabs."""
        return "\n".join(
            f"% {part.title}, {split} shapes\n"
            + latex_table(["method", *(column.heading for column in columns)], rows)
            for part, tables in self._parts()
            for split, columns, rows in tables
        )

    def csv(self) -> str:
        """One line for every method, seed and split, all figures at full precision."""
        keys = list(dict.fromkeys(column.key for part in PARTS for column in part.columns))
        names = ("collection", "variant", "method")
        text = io.StringIO()
        writer = csv.DictWriter(text, [*names, "split", *keys], lineterminator="\n")
        writer.writeheader()
        for split in self.splits:
            for summary in self.summaries:
                group = figures(summary, split)
                known: dict[str, Any] = {name: summary.get(name, "") for name in names}
                if group:
                    kept = {key: group[key] for key in keys if key in group}
                    writer.writerow(known | {"split": split} | kept)
        return text.getvalue()

    def rows(self, split: str) -> list[Row]:
        """The methods that have shapes in a split, seeds together."""
        found: dict[str, list[dict[str, float]]] = {}
        learnt = set()
        for summary in self.summaries:
            label, group = without_seed(summary_label(summary)), figures(summary, split)
            if group:
                found.setdefault(label, []).append(group)
            if summary["method"] == "gensp":
                learnt.add(label)
        return [Row(label, tuple(groups), label in learnt) for label, groups in found.items()]

    def _parts(self) -> Iterator[tuple[Part, list[tuple[str, Sequence[Column], list[list[str]]]]]]:
        for part in PARTS:
            tables = [
                (split, *known) for split in self.splits if (known := self._table(part, split))
            ]
            if tables:
                yield part, tables

    def _table(self, part: Part, split: str) -> tuple[list[Column], list[list[str]]] | None:
        """Columns of which there is a figure, and the rows."""
        rows = self.rows(split)
        columns = [
            column
            for column in part.columns
            if any(_told(group, column) for row in rows for group in row.groups)
        ]
        told = [[row.label, *(row.cell(column) for column in columns)] for row in rows]
        return (columns, told) if told and columns else None


def figures(summary: Summary, split: str) -> dict[str, float]:
    """All figures of one evaluation and split; nothing where it has none."""
    group = summary["groups"].get(split)
    if not group:
        return {}
    # JSON has no word for infinity: a figure that is there and null, of a map with a collapsed
    # triangle.
    known = {key: math.inf if value is None else value for key, value in group.items()}
    # What failed is listed without its split.
    failed = {"failures": len(summary.get("failed") or ())} if split == "all" else {}
    return known | failed


def _told(group: Mapping[str, float], column: Column) -> bool:
    """Whether a group has such a figure; no pairs are none."""
    value = group.get(column.key)
    return value is not None and not (column.key.endswith("pairs") and value == 0)


def without_seed(label: str) -> str:
    """A row's name without what a sweep over seeds adds to it."""
    return _SEED.sub("", label)
