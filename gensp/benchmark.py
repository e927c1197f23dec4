"""Methods side by side: distortion, consistency, bijectivity, run time (paper Table 1)."""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gensp.tables import Column, Summary, cell, latex_table, markdown_table, summary_label

_SEED = re.compile(r"\+seed-\d+")


@dataclass(frozen=True)
class Part:
    """One of the tables: its title and its columns."""

    title: str
    columns: tuple[Column, ...]


PARTS = (
    Part(
        "Distortion",
        (
            Column("sigma_mean", "mean σ", "isometric distortion, mean over triangles, shapes"),
            Column("sigma_max_mean", "max σ", "largest of any triangle, mean over shapes"),
            Column("sigma_max", "worst σ", "largest of any triangle of any shape"),
            Column("conformal_mean", "mean σ^con", "conformal distortion, as mean σ"),
            Column("conformal_max", "worst σ^con", "conformal distortion, as worst σ"),
            Column("coverage_mean", "coverage", "shape to icosphere remesh over √area, mean", 4),
            Column("coverage_max", "max coverage", "the same, largest", 4),
        ),
    ),
    Part(
        "Consistency",
        (
            Column("c", "c", "consistency of the paper, over nearest of the pairs, no rotation"),
            Column("c_registered", "c (registered)", "after a rotation found without truth"),
            Column("c_rotated", "c (rotated)", "rotated as error (rotated)"),
            Column("error", "error", "implied correspondence over √area, no rotation", 4),
            Column("error_registered", "error (registered)", "as c (registered)", 4),
            Column(
                "error_rotated",
                "error (rotated)",
                "after the rotation of each pair that makes it least",
                4,
            ),
            Column("error_median", "median error", "over pairs, no rotation", 4),
            Column("geodesic", "geodesic", "error along the surface, no rotation", 4),
            Column("geodesic_rotated", "geodesic (rotated)", "rotated as error (rotated)", 4),
            Column("within", "within 0.05", "share of points of at most that geodesic error"),
            Column("within_rotated", "within 0.05 (rotated)", "rotated as error (rotated)"),
            Column("pairs", "pairs", "pairs with dense ground truth that were measured", 0),
        ),
    ),
    Part(
        "Keypoints of shapes without common dense truth",
        (
            Column("keypoint_error", "error", "implied correspondence over √area, no rotation", 4),
            Column("keypoint_error_registered", "error (registered)", "after such a rotation", 4),
            Column("keypoint_error_rotated", "error (rotated)", "after the best of each pair", 4),
            Column("keypoint_pairs", "pairs", "pairs of shapes that were measured", 0),
        ),
    ),
    Part(
        "Bijectivity",
        (
            Column("shapes", "shapes", "shapes with a map", 0),
            Column("failures", "failures", "shapes without one, or whose map was not measured", 0),
            Column("bad_faces_percent", "bad faces %", "folded or collapsed on the sphere", 4),
            Column("affected_shapes", "affected", "shapes with a bad face or such a degree", 0),
            Column("wrong_degree", "degree ≠ ±1", "shapes of another degree than 1 or -1", 0),
        ),
    ),
    Part(
        "Run time",
        (
            Column("seconds_median", "seconds", "run time for one shape, median", 2),
            Column("seconds_max", "max seconds", "the same, largest", 2),
            Column("vertices_median", "vertices", "of a shape, median", 0),
            Column("vertices_max", "max vertices", "of a shape, largest", 0),
        ),
    ),
)


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
            if any(group.get(column.key) is not None for row in rows for group in row.groups)
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


def without_seed(label: str) -> str:
    """A row's name without what a sweep over seeds adds to it."""
    return _SEED.sub("", label)
