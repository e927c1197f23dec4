"""The benchmark of methods: tables that say what the summaries say, and the command."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import finished_items, train

from gensp.benchmark import Benchmark
from gensp.columns import PARTS
from gensp.comparison import compare_methods
from gensp.pictures.methods import MethodFigures, curves_figure, methods_figure
from gensp.places import places_markdown
from gensp.tables import latex_table, latex_text, read_summary_csv
from gensp.tasks.evaluate import Circle

FILES = ("table.md", "table.csv", "table.tex", "plot.png", "curves.png")
REASON = "vertex 7 finds no place on the sphere; remesh the surface"


def summary(variant: str, sigma: float, failed: int = 0, method: str | None = None) -> dict:
    figures = {
        "shapes": 5 - failed,
        "sigma_mean": sigma,
        "sigma_max": 10 * sigma,
        "conformal_max": 3 * sigma,
        "coverage_max": 0.01,
        "error": sigma / 50,
        "error_registered": sigma / 100,
        "keypoint_error": sigma / 20,
        "bad_faces_percent": 0.25,
        "wrong_degree": 0,
        "seconds_median": 2.5,
    }
    return {
        "experiment": "benchmark-heads",
        "variant": variant,
        "method": method or variant.split("+")[0],
        "collection": "heads",
        "groups": {"test": {**figures, "shapes": 2}, "all": figures},
        "failed": [{"id": f"s{at}", "error": f"s{at}: {REASON}"} for at in range(failed)],
    }


def test_markdown_has_every_part_and_the_reasons_of_failures() -> None:
    text = Benchmark((summary("dirichlet", 1.2345), summary("ahsp", 2.5, failed=1))).markdown()
    assert [text.index(f"## {part.title}, all shapes") for part in PARTS]
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    tables = [
        {line[0]: dict(zip(header, line, strict=True)) for line in lines[at + 2 : at + 4]}
        for at, header in enumerate(lines)
        if header[0] == "method"
    ]
    distortion, consistency, keypoints, bijectivity, _ = tables
    assert distortion["dirichlet"]["mean σ"] == "1.234"
    assert distortion["ahsp"]["worst σ"] == "25.000"
    assert distortion["ahsp"]["max coverage"] == "0.0100"
    assert consistency["ahsp"]["error"] == "0.0500"
    assert keypoints["ahsp"]["error"] == "0.1250"
    assert bijectivity["dirichlet"]["failures"] == "0"
    assert bijectivity["ahsp"]["failures"] == "1"
    assert f"- ahsp, s0: {REASON}" in text
    assert "c (rotated)" not in text  # no figure, no column


def test_no_pairs_are_no_table() -> None:
    alone = summary("dirichlet", 1.2)
    del alone["groups"]["all"]["keypoint_error"]
    alone["groups"]["all"]["keypoint_pairs"] = 0
    assert "Keypoints" not in Benchmark((alone,)).markdown()


def test_shapes_that_were_not_learnt_from_stand_apart() -> None:
    learnt = summary("full", 1.5, method="gensp")
    assert Benchmark((summary("dirichlet", 1.2),)).splits == ("all",)
    assert Benchmark((learnt, summary("dirichlet", 1.2))).splits == ("test", "train", "all")


def test_seeds_are_one_row_with_their_spread() -> None:
    runs = [summary(f"full+certify+seed-{k}", 1.0 + k, method="gensp") for k in range(3)]
    (row,) = Benchmark(tuple(runs)).rows("all")
    assert row.label == "full+certify"
    sigma = PARTS[0].columns[0]
    assert row.cell(sigma) == "2.000 ± 1.000"
    assert row.mean("sigma_mean") == 2
    lines = Benchmark(tuple(runs)).csv().splitlines()
    assert sum(line.startswith("heads,full+certify+seed-") for line in lines) == 6


def test_places_tell_who_is_first_and_who_folds() -> None:
    learnt = summary("full", 1.5, method="gensp")
    folding = summary("arap+dirichlet", 1.0)
    folding["groups"]["all"]["affected_shapes"] = 4
    slow = summary("ahsp", 2.0)
    slow["groups"]["all"]["within"] = 0.9
    learnt["groups"]["all"]["within"] = 0.8
    text = places_markdown(Benchmark((learnt, folding, slow)))
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    told = {line[0]: line[1:] for line in lines[lines.index(lines[-1]) - 12 :] if len(line) == 4}
    assert told["mean σ"] == ["arap+dirichlet (1.000)", "full (1.500)", "1 of 2"]
    assert told["within 0.05"] == ["ahsp (0.900)", "ahsp (0.900)", "2 of 2"]
    assert told["keypoint error"][2] == "1 of 2"
    assert places_markdown(Benchmark((folding, slow))) == ""


def test_csv_says_what_the_summaries_say_to_the_last_digit() -> None:
    summaries = (summary("dirichlet", 4 / 3), summary("arap+dirichlet", 7 / 3, failed=2))
    rows = read_summary_csv(Benchmark(summaries).csv())
    assert [row["variant"] for row in rows] == ["dirichlet", "arap+dirichlet"]
    for row, found in zip(rows, summaries, strict=True):
        group = found["groups"]["all"]
        assert {key: row[key] for key in group} == group
        assert row["failures"] == len(found["failed"])


def test_a_collapsed_triangle_shows_as_infinite_distortion() -> None:
    collapsed = summary("cmcf_raw", 1.5)
    collapsed["groups"]["all"]["sigma_max"] = None  # as JSON keeps what is not finite
    table = Benchmark((collapsed,))
    assert "| cmcf_raw | 1.500 | ∞ |" in table.markdown()
    assert read_summary_csv(table.csv())[0]["sigma_max"] == float("inf")


@pytest.mark.parametrize(
    ("text", "typeset"),
    [
        ("cmcf_raw", r"cmcf\_raw"),
        ("50 % & more #1 {a}", r"50 \% \& more \#1 \{a\}"),
        ("mean σ^con", r"mean $\sigma^{\mathrm{con}}$"),
        ("a^b~c\\d", r"a\textasciicircum{}b\textasciitilde{}c\textbackslash{}d"),
        ("degree ≠ ±1", r"degree $\neq$ $\pm$1"),
        ("–", "--"),
    ],
)
def test_latex_escapes(text: str, typeset: str) -> None:
    assert latex_text(text) == typeset


def test_latex_has_as_many_columns_as_it_announces() -> None:
    lines = latex_table(["method", "bad %"], [["cmcf_raw", "1.5"], ["arap", "–"]]).splitlines()
    assert lines[0] == r"\begin{tabular}{lr}"
    assert r"  cmcf\_raw & 1.5 \\" in lines
    assert [line.count(" & ") for line in lines if line.endswith(r"\\")] == [1, 1, 1]
    whole = Benchmark((summary("cmcf_raw", 1.2),)).latex()
    assert whole.count(r"\begin{tabular}") == whole.count(r"\end{tabular}") == len(PARTS)


def test_a_curve_of_a_method_that_fails_ends_below_one() -> None:
    methods = [
        MethodFigures("whole", 1.2, 0.01, [3.0, 2.0, 4.0]),
        MethodFigures("failing", 1.3, 0.02, [5.0, 2.0], failures=2, rotated=0.01),
    ]
    points, curves = methods_figure(methods).axes
    assert [list(line.get_xdata()) for line in points.lines] == [[0.01], [0.02, 0.01], [0.02]]
    ends = {line.get_label(): line.get_ydata()[-1] for line in curves.lines}
    assert ends == {"whole": 1.0, "failing": 0.5}
    assert list(curves.lines[0].get_xdata()) == [2.0, 3.0, 4.0]
    without = [MethodFigures("no truth", 1.2, None, [3.0])]
    assert len(methods_figure(without).axes) == 1


def test_curves_are_drawn_for_every_split_and_turn() -> None:
    lines = {"raw": [0, 0.5], "geodesic_rotated": [0, 0.75]}
    other = {"raw": [0, 0.7], "geodesic_rotated": [0, 0.85]}
    seeds = [{"thresholds": [0, 0.1], "test": found, "all": found} for found in (lines, other)]
    method = MethodFigures("full", 1.2, 0.01, [3.0], curves=seeds)
    drawn = curves_figure([method], ("test", "train", "all")).axes
    titles = [panel.get_title(loc="left").split(",")[0] for panel in drawn]
    assert titles == 4 * ["test shapes"] + 4 * ["all shapes"]
    np.testing.assert_allclose(drawn[0].lines[0].get_ydata(), [0, 0.6])
    np.testing.assert_allclose(drawn[3].lines[0].get_ydata(), [0, 0.8])
    assert not drawn[1].lines


def test_a_method_keeps_its_colour_whatever_stands_beside_it() -> None:
    names = [
        "full+certify",
        "full+register+certify",
        "ahsp",
        "arap+dirichlet",
        "dirichlet",
        "vc25",
    ]
    many = [MethodFigures(name, 1.2, 0.01, [3.0]) for name in names]
    colours = {m.label: line.get_color() for m, line in _lines(many)}
    assert len(set(colours.values())) == len(many)
    for alone in many[2:]:
        ((_, line),) = _lines([alone])
        assert line.get_color() == colours[alone.label]


def _lines(methods: list[MethodFigures]) -> list[tuple[MethodFigures, object]]:
    drawn = methods_figure(methods).axes[-1].lines
    return list(zip(methods, drawn, strict=True))


def test_partners_are_mutual_and_equally_many() -> None:
    circle = Circle([f"s{number}" for number in range(11)])
    drawn = {place: circle.near(place, 4) for place in range(11)}
    assert all(len(others) == 4 and place not in others for place, others in drawn.items())
    assert all(place in drawn[other] for place, others in drawn.items() for other in others)
    assert circle.near(3, 0) == []
    for many in (None, 10, 40):
        assert circle.near(3, many) == [place for place in range(11) if place != 3]


def test_an_experiment_without_evaluations_gets_no_table(tmp_path: Path) -> None:
    assert compare_methods(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_two_methods_by_one_command(tmp_path: Path) -> None:
    words = (
        "-m",
        "experiment=benchmark",
        "stage=parameterize,evaluate",
        "method=dirichlet,cmcf_raw",
    )
    small = (
        "shapes=blobs",
        "shapes.count=5",
        "shapes.vertices=300",
        "recipe=smoke",
        "threads=1",
        "workers.jobs=1",
    )
    command = (
        *words,
        *small,
        "recipe.evaluate.partners=2",
        f"paths.runs={tmp_path}",
        f"paths.cache={tmp_path}/cache",
    )
    train(*command)
    folder = tmp_path / "benchmark-blobs"
    assert all((folder / name).stat().st_size > 0 for name in FILES)
    rows = {row["variant"]: row for row in read_summary_csv((folder / "table.csv").read_text())}
    assert list(rows) == ["cmcf_raw", "dirichlet"]
    for variant, row in rows.items():
        found = json.loads((folder / variant / "evaluate/summary.json").read_text())
        group = found["groups"]["all"]
        assert (row["shapes"], row["pairs"], row["failures"]) == (5, 5, 0)
        same = [key for part in PARTS for column in part.columns if (key := column.key) in group]
        assert {key: row[key] for key in same} == {key: group[key] for key in same}

    assert rows["dirichlet"]["affected_shapes"] == 0

    # One map is lost; all others stay as they are.
    maps = folder / "cmcf_raw/parameterize"
    before = finished_items(maps)
    lost = sorted(before)[2]
    lost.unlink()
    (maps / "manifest.json").unlink()
    done = train(*command)
    assert done.stdout.count("finished before") == 3
    after = finished_items(maps)
    assert set(after) == set(before)
    assert {path for path in before if after[path] != before[path]} == {lost}
