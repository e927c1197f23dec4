"""Tables: what is written is what was measured."""

import json

import pytest

from gensp.tables import (
    cell,
    columns_of,
    combine_summaries,
    read_summary_csv,
    rich_table,
    summary_csv,
    summary_label,
    summary_markdown,
)


def summary(variant: str = "full", method: str = "gensp", error: float | None = 0.0107) -> dict:
    test = {"shapes": 6, "sigma_mean": 1.49123456789, "sigma_max": 1.2e7, "error": error}
    train = {"shapes": 20, "sigma_mean": 1.4, "sigma_max": 9.25, "bad_faces_percent": 0.0}
    return {
        "experiment": "quickstart",
        "variant": variant,
        "method": method,
        "collection": "heads",
        "normalization": "area 4π",
        "groups": {"train": train, "test": test},
        "skipped": [{"id": "torn", "reason": "12 boundary edges (open surface)"}],
        "failed": [],
    }


def markdown_cells(text: str, row: str) -> dict[str, str]:
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    found = next(line for line in lines if line[0] == row)
    return dict(zip(lines[0], found, strict=True))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (1.49123, 3, "1.491"),
        (6, 0, "6"),
        (1.13e4, 3, "1.13e+04"),
        (None, 3, "–"),
        (float("nan"), 3, "–"),
        (float("inf"), 3, "∞"),
    ],
)
def test_cell_is_readable(value, digits, text):
    assert cell(value, digits) == text


def test_markdown_has_the_figures_under_the_papers_columns():
    cells = markdown_cells(summary_markdown(summary()), "test")
    assert cells["mean σ"] == "1.491"
    assert cells["worst σ"] == "1.20e+07"
    assert cells["error"] == "0.0107"
    assert cells["bad faces %"] == "–"


def test_markdown_lists_skipped_shapes():
    assert "- torn: 12 boundary edges" in summary_markdown(summary())


def test_columns_without_any_figure_are_left_out():
    assert "error" not in [column.key for column in columns_of([summary(error=None)])]


def test_csv_round_trip_is_exact():
    rows = read_summary_csv(summary_csv(summary()))
    assert [row["split"] for row in rows] == ["train", "test"]
    assert rows[1]["sigma_mean"] == 1.49123456789
    assert rows[0]["error"] is None
    assert rows[1]["shapes"] == 6


def test_csv_and_json_say_the_same():
    rows = read_summary_csv(summary_csv(json.loads(json.dumps(summary()))))
    for split, group in summary()["groups"].items():
        row = next(row for row in rows if row["split"] == split)
        assert {key: row[key] for key in group} == group


def test_terminal_table_has_a_row_for_every_split():
    table = rich_table(summary())
    assert table.row_count == 2
    assert "mean σ" in [column.header for column in table.columns]


def test_comparison_has_a_row_for_every_variant():
    both = combine_summaries([summary(), summary("cmcf", "cmcf", error=0.0262)])
    text = both.markdown()
    assert markdown_cells(text, "full")["error"] == "0.0107"
    assert markdown_cells(text, "cmcf")["error"] == "0.0262"
    assert text.index("## test") < text.index("## train")
    assert both.rich("test").row_count == 2
    assert len(read_summary_csv(both.csv())) == 4


@pytest.mark.parametrize(
    ("variant", "method", "label"),
    [
        ("full+register", "gensp", "full+register"),
        ("cmcf+unrefined", "cmcf", "cmcf+unrefined"),
        ("full", "cmcf", "cmcf full"),
    ],
)
def test_label_names_variant_and_method_once(variant, method, label):
    assert summary_label(summary(variant, method)) == label
