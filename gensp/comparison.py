"""All variants and methods of one experiment side by side, as Table 1 of the paper."""

import csv
from pathlib import Path

from gensp.benchmark import Benchmark
from gensp.files import read_json, write_text
from gensp.tables import Comparison, Summary, combine_summaries, summary_label

# The paper's order: the method, its ablations, then the methods it is compared with.
_FIRST = ("full", "no_da", "no_gp", "no_gr")


def compare_variants(experiment: Path) -> Comparison:
    """Write summary.md and summary.csv of an experiment's folder from its finished evaluations.

    Reads every `<variant>/evaluate/summary.json`; a variant that is not evaluated yet is absent.
    """
    comparison = combine_summaries(_evaluated(experiment).values())
    if comparison.summaries:
        write_text(experiment / "summary.md", comparison.markdown())
        write_text(experiment / "summary.csv", comparison.csv())
    return comparison


def compare_methods(experiment: Path) -> list[Path]:
    """Write table.md, table.csv, table.tex and plot.png of an experiment's folder.

    Returns
    -------
    list
        What was written; nothing where no evaluation has a summary.
    """
    found = _evaluated(experiment)
    if not found:
        return []
    benchmark = Benchmark(tuple(found.values()))
    texts = {
        "table.md": benchmark.markdown(),
        "table.csv": benchmark.csv(),
        "table.tex": benchmark.latex(),
    }
    for name, text in texts.items():
        write_text(experiment / name, text)
    _plot(experiment / "plot.png", found)
    return [experiment / name for name in (*texts, "plot.png")]


def _plot(path: Path, found: dict[Path, Summary]) -> None:
    # Imported late: matplotlib takes a second.
    from gensp.pictures.curves import save_figure
    from gensp.pictures.methods import MethodFigures, methods_figure

    methods = [
        MethodFigures(
            label=summary_label(summary),
            sigma_mean=summary["groups"]["all"].get("sigma_mean"),
            error=summary["groups"]["all"].get("error_registered"),
            sigma_max=_largest(folder / "shapes.csv"),
            failures=len(summary.get("failed") or ()),
        )
        for folder, summary in found.items()
        if "all" in summary["groups"]
    ]
    save_figure(methods_figure(methods), path)


def _largest(path: Path) -> list[float]:
    """The largest σ of every shape of an evaluation."""
    with open(path, encoding="utf-8", newline="") as file:
        return [float(row["sigma_max"]) for row in csv.DictReader(file) if row["sigma_max"]]


def _evaluated(experiment: Path) -> dict[Path, Summary]:
    """The summaries of an experiment by the folder of their evaluation, in the paper's order."""
    paths = sorted(experiment.glob("*/evaluate/summary.json"), key=_place)
    return {path.parent: read_json(path) for path in paths}


def _place(path: Path) -> tuple[int, str]:
    variant = path.parent.parent.name
    base = variant.split("+")[0]
    return (_FIRST.index(base) if base in _FIRST else len(_FIRST), variant)
