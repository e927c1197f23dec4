"""The table of the evaluation, in the paper's columns: Markdown, CSV, JSON, terminal."""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gensp.columns import COLUMNS, TERMINAL, Column

if TYPE_CHECKING:
    from rich.table import Table

Summary = Mapping[str, Any]

# What a summary lists besides its figures: key, title, where the reason is.
_LEFT_OUT = (
    ("skipped", "Skipped", "reason"),
    ("lost", "Not learnt from", "reason"),
    ("failed", "Failed", "error"),
)


def columns_of(summaries: Iterable[Summary], keys: Sequence[str] | None = None) -> list[Column]:
    """The columns for which at least one group of one summary has a figure."""
    groups = [group for summary in summaries for group in summary["groups"].values()]
    return [
        column
        for column in COLUMNS
        if (keys is None or column.key in keys)
        and any(group.get(column.key) is not None for group in groups)
    ]


def cell(value: Any, digits: int) -> str:
    """A figure for reading: fixed digits, powers of ten when huge, a dash where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if math.isinf(value):
        return "∞"
    return f"{value:.2e}" if abs(value) >= 1e4 else f"{value:.{digits}f}"


def _rows(summary: Summary, columns: Sequence[Column]) -> Iterator[list[str]]:
    for name, group in summary["groups"].items():
        yield [name, *(cell(group.get(column.key), column.digits) for column in columns)]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column to the left, figures to the right."""
    rule = ["---", *["--:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in [list(header), rule, *rows]) + "\n"


# What LaTeX reads otherwise, and signs that a plain font lacks.
_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
    "σ^con": r"$\sigma^{\mathrm{con}}$",
    "σ": r"$\sigma$",
    "√": r"$\surd$",
    "≠": r"$\neq$",
    "±": r"$\pm$",
    "∞": r"$\infty$",
    "–": "--",
}
_LATEX_SIGNS = re.compile("|".join(map(re.escape, sorted(_LATEX, key=len, reverse=True))))


def latex_text(text: str) -> str:
    """A text as LaTeX sets it, every sign as it stands."""
    return _LATEX_SIGNS.sub(lambda found: _LATEX[found.group()], text)


def latex_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A tabular with the rules of booktabs; the first column to the left, figures to the right."""
    head, *body = (
        "  " + " & ".join(map(latex_text, line)) + r" \\" for line in [list(header), *rows]
    )
    begin = rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}"
    lines = [begin, r"  \toprule", head, r"  \midrule", *body, r"  \bottomrule", r"\end{tabular}"]
    return "\n".join(lines) + "\n"


def summary_label(summary: Summary) -> str:
    """What a row of a joint table is called: the variant, with the method if that adds a word."""
    variant, method = summary.get("variant") or "", summary.get("method") or ""
    return variant if method in variant or method == "gensp" else f"{method} {variant}".strip()


def summary_markdown(summary: Summary) -> str:
    """One evaluation as Markdown: a row a split, the columns explained, what is missing."""
    columns = columns_of([summary])
    title = f"# {summary.get('collection', '')}: {summary_label(summary) or summary['method']}"
    table = markdown_table(["split", *_headings(columns)], _rows(summary, columns))
    parts = [title, table, _legend(columns, summary), *_left_out(summary)]
    return "\n".join(part.rstrip() + "\n" for part in parts)


def _headings(columns: Sequence[Column]) -> list[str]:
    return [column.heading for column in columns]


def _legend(columns: Sequence[Column], summary: Summary) -> str:
    lines = [f"- **{column.heading}**: {column.meaning}" for column in columns]
    if summary.get("normalization"):
        lines.append(f"- Scale: {summary['normalization']}")
    return "\n".join(lines)


def _left_out(summary: Summary) -> Iterator[str]:
    for key, title, reason in _LEFT_OUT:
        if summary.get(key):
            lines = [f"- {item['id']}: {item[reason]}" for item in summary[key]]
            yield "\n".join([f"## {title}", "", *lines])


def summary_csv(summary: Summary) -> str:
    """One line for every split, every metric of the summary at full precision."""
    return _csv([summary])


def _csv(summaries: Sequence[Summary]) -> str:
    groups = [group for summary in summaries for group in summary["groups"].values()]
    keys = list(dict.fromkeys(key for group in groups for key in group))
    head = ("experiment", "variant", "method", "collection")
    text = io.StringIO()
    writer = csv.DictWriter(text, [*head, "split", *keys], lineterminator="\n")
    writer.writeheader()
    for summary in summaries:
        for split, group in summary["groups"].items():
            writer.writerow({key: summary.get(key, "") for key in head} | {"split": split} | group)
    return text.getvalue()


def read_summary_csv(text: str) -> list[dict[str, Any]]:
    """The lines of `summary_csv` with numbers as numbers and empty cells as None."""
    return [
        {key: _number(value) for key, value in row.items()}
        for row in csv.DictReader(io.StringIO(text))
    ]


def _number(text: str) -> str | float | int | None:
    if text == "":
        return None
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def rich_table(summary: Summary) -> "Table":
    """The table for a terminal: the columns that fit, a line for every split."""
    columns = columns_of([summary], TERMINAL)
    title = f"{summary.get('collection', '')} · {summary_label(summary) or summary['method']}"
    return _terminal(title, ["split", *_headings(columns)], _rows(summary, columns))


def _terminal(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> "Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left", header_style="bold")
    for index, heading in enumerate(header):
        table.add_column(heading, justify="left" if index == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


@dataclass(frozen=True)
class Comparison:
    """Several variants or methods in one table, a row each, for one split at a time."""

    summaries: tuple[Summary, ...]

    @property
    def splits(self) -> list[str]:
        """The splits that any of the summaries has, in the table's order."""
        found = {name for summary in self.summaries for name in summary["groups"]}
        return [name for name in ("test", "val", "train", "all") if name in found]

    def _cells(self, split: str, columns: Sequence[Column]) -> Iterator[list[str]]:
        for summary in self.summaries:
            group = summary["groups"].get(split)
            if group is not None:
                figures = (cell(group.get(column.key), column.digits) for column in columns)
                yield [summary_label(summary), *figures]

    def markdown(self) -> str:
        """A heading and a table for every split, then the meaning of the columns."""
        columns = columns_of(self.summaries)
        parts = [
            f"## {split}\n\n"
            + markdown_table(["variant", *_headings(columns)], self._cells(split, columns))
            for split in self.splits
        ]
        return "\n".join([*parts, _legend(columns, self.summaries[0]) + "\n"])

    def csv(self) -> str:
        """One line for every variant and split, at full precision."""
        return _csv(self.summaries)

    def rich(self, split: str) -> "Table":
        """One split for a terminal."""
        columns = columns_of(self.summaries, TERMINAL)
        header = ["variant", *_headings(columns)]
        return _terminal(f"{split} shapes", header, self._cells(split, columns))


def combine_summaries(summaries: Iterable[Summary]) -> Comparison:
    """Put variants and methods side by side, as Table 1 of the paper does."""
    return Comparison(tuple(summaries))
