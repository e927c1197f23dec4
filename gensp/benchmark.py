"""Methods side by side: distortion and consistency, bijectivity, run time (paper Table 1)."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gensp.tables import Column, Summary, cell, latex_table, markdown_table, summary_label


@dataclass(frozen=True)
class Part:
    """One of the tables: its title and its columns."""

    title: str
    columns: tuple[Column, ...]


PARTS = (
    Part(
        "Distortion and consistency",
        (
            Column("sigma_mean", "mean σ", "isometric distortion, mean over triangles, shapes"),
            Column("sigma_max_mean", "max σ", "largest of any triangle, mean over shapes"),
            Column("sigma_max", "worst σ", "largest of any triangle of any shape"),
            Column("conformal_mean", "mean σ^con", "conformal distortion, as mean σ"),
            Column("c", "c", "consistency of the paper, over nearest neighbours, no rotation"),
            Column("c_registered", "c (registered)", "after a rotation found without truth"),
            Column("c_rotated", "c (rotated)", "after the best rotation of each pair"),
            Column("error", "error", "implied correspondence over √area, no rotation", 4),
            Column("error_registered", "error (registered)", "as c (registered)", 4),
            Column("error_rotated", "error (rotated)", "as c (rotated)", 4),
            Column("keypoint_error_registered", "keypoints (registered)", "across templates", 4),
            Column("pairs", "pairs", "pairs with dense ground truth that were measured", 0),
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


@dataclass(frozen=True)
class Benchmark:
    """The tables of several evaluations of one collection.

    All shapes count alike for methods that learn nothing; where one learns, shapes that it has not
    seen are a group of their own.
    """

    summaries: tuple[Summary, ...]

    @property
    def splits(self) -> tuple[str, ...]:
        """The groups of shapes that are shown."""
        learnt = any(summary["method"] == "gensp" for summary in self.summaries)
        return ("test", "all") if learnt else ("all",)

    def markdown(self) -> str:
        """A table for every part and split, the meaning of the columns, what failed and why."""
        lines = [f"# {self.summaries[0].get('collection', '')}: methods side by side", ""]
        for part, split, columns, rows in self._tables():
            header = ["method", *(column.heading for column in columns)]
            lines += [f"## {part.title}, {split} shapes", "", markdown_table(header, rows)]
            lines += [f"- **{column.heading}**: {column.meaning}" for column in columns]
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
            for part, split, columns, rows in self._tables()
        )

    def csv(self) -> str:
        """One line for every method and split, all figures at full precision."""
        keys = [column.key for part in PARTS for column in part.columns]
        names = ("collection", "variant", "method")
        text = io.StringIO()
        writer = csv.DictWriter(text, [*names, "split", *keys], lineterminator="\n")
        writer.writeheader()
        for split in self.splits:
            for summary, group in self._groups(split):
                known = {name: summary.get(name, "") for name in names}
                writer.writerow(
                    known | {"split": split} | {key: group[key] for key in keys if key in group}
                )
        return text.getvalue()

    def _groups(self, split: str) -> Iterator[tuple[Summary, dict[str, float]]]:
        for summary in self.summaries:
            if split in summary["groups"]:
                # JSON has no word for infinity: a figure that is there and null, of a map with a
                # collapsed triangle.
                group = {
                    key: math.inf if value is None else value
                    for key, value in summary["groups"][split].items()
                }
                # What failed is listed without its split.
                failed = {"failures": len(summary.get("failed") or ())} if split == "all" else {}
                yield summary, group | failed

    def _tables(self) -> Iterator[tuple[Part, str, Sequence[Column], list[list[str]]]]:
        for part in PARTS:
            for split in self.splits:
                groups = list(self._groups(split))
                columns = [
                    column
                    for column in part.columns
                    if any(group.get(column.key) is not None for _, group in groups)
                ]
                rows = [
                    [
                        summary_label(summary),
                        *(cell(group.get(column.key), column.digits) for column in columns),
                    ]
                    for summary, group in groups
                ]
                if rows and columns:
                    yield part, split, columns, rows
