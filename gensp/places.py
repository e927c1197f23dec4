"""Who is first in each column of a benchmark, and where the learnt methods stand."""

import math
from collections.abc import Iterator, Sequence

from gensp.benchmark import Benchmark, Row
from gensp.columns import PARTS, Column
from gensp.tables import markdown_table

_LARGEST_FIRST = {"within", "within_rotated"}
_NOT_RANKED = {
    *("pairs", "keypoint_pairs", "frame_pairs"),
    *("shapes", "failures", "affected_shapes", "wrong_degree"),
    *(
        "vertices_median",
        "vertices_max",
        "seconds_max",
        "processor_seconds_max",
        "bad_faces_percent",
    ),
}


def places_markdown(benchmark: Benchmark) -> str:
    """A table for every split, empty where nothing is learnt.

    A row a column: the best method, the best that folds nothing, and the place of each learnt
    method among those that fold nothing.
    """
    parts = []
    for split in benchmark.splits:
        rows = benchmark.rows(split)
        learnt = [row for row in rows if row.learnt]
        lines = list(_lines(rows, learnt)) if learnt else []
        if lines:
            header = ["column", "first", "first that folds nothing", *(r.label for r in learnt)]
            parts += [f"## Places, {split} shapes", "", markdown_table(header, lines)]
    return "\n".join(parts)


def _lines(rows: Sequence[Row], learnt: Sequence[Row]) -> Iterator[list[str]]:
    sound = [row for row in rows if not row.mean("affected_shapes")]
    for part in PARTS:
        for column in part.columns:
            if column.key in _NOT_RANKED or not _ranked(rows, column):
                continue
            order = _ranked(sound, column)
            found = [_place(row, order) for row in learnt]
            named = [_named(_ranked(rows, column), column), _named(order, column)]
            yield [_heading(part.title, column), *named, *found]


def _heading(title: str, column: Column) -> str:
    return f"keypoint {column.heading}" if title.startswith("Keypoints") else column.heading


def _named(order: Sequence[Row], column: Column) -> str:
    return f"{order[0].label} ({order[0].cell(column)})" if order else "–"


def _place(row: Row, order: Sequence[Row]) -> str:
    return f"{order.index(row) + 1} of {len(order)}" if row in order else "–"


def _ranked(rows: Sequence[Row], column: Column) -> list[Row]:
    """The rows that have a figure, the best first."""
    sign = -1 if column.key in _LARGEST_FIRST else 1
    values = {place: row.mean(column.key) for place, row in enumerate(rows)}
    known = {place: x for place, x in values.items() if x is not None and not math.isnan(x)}
    return [rows[place] for place in sorted(known, key=lambda place: sign * known[place])]
