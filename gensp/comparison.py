"""All variants and methods of one experiment side by side, as Table 1 of the paper."""

import csv
from pathlib import Path
from typing import TYPE_CHECKING

from gensp.benchmark import Benchmark, best_baselines, without_seed
from gensp.files import read_json, write_text
from gensp.places import places_markdown
from gensp.tables import Comparison, Summary, combine_summaries, summary_label

if TYPE_CHECKING:
    from gensp.pictures.methods import MethodFigures

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
    """Write table.md, table.csv, table.tex, plot.png and curves.png of an experiment's folder.

    Returns
    -------
    list
        What was written; nothing where no evaluation has a summary, and no curves where no pair
        has dense ground truth.
    """
    found = _evaluated(experiment)
    if not found:
        return []
    benchmark = Benchmark(tuple(found.values()))
    texts = {
        "table.md": "\n".join(filter(None, (benchmark.markdown(), places_markdown(benchmark)))),
        "table.csv": benchmark.csv(),
        "table.tex": benchmark.latex(),
    }
    for name, text in texts.items():
        write_text(experiment / name, text)
    return [*(experiment / name for name in texts), *_plots(experiment, found, benchmark)]


def baselines(experiment: Path, *, besides: Path, count: int) -> dict[str, Path]:
    """Maps of the best methods that learn nothing: name → folder of stage parameterize.

    Parameters
    ----------
    besides
        A folder of maps that is not one of them.
    """
    found = {folder.with_name("parameterize"): s for folder, s in _evaluated(experiment).items()}
    found.pop(besides, None)
    best = best_baselines(found.values(), count)
    return {summary_label(s): f for s in best for f, summary in found.items() if summary is s}


def _plots(experiment: Path, found: dict[Path, Summary], benchmark: Benchmark) -> list[Path]:
    # Imported late: matplotlib takes a second.
    from gensp.pictures.curves import save_figure
    from gensp.pictures.methods import curves_figure, methods_figure

    methods = _methods(found, benchmark)
    paths = [save_figure(methods_figure(methods), experiment / "plot.png")]
    if any(len(curves) > 0 for method in methods for curves in method.curves):
        curves = curves_figure(methods, benchmark.splits)
        paths.append(save_figure(curves, experiment / "curves.png"))
    return paths


def _methods(found: dict[Path, Summary], benchmark: Benchmark) -> list["MethodFigures"]:
    """What is drawn of every row: means over seeds, the shapes of all of them together."""
    from gensp.pictures.methods import MethodFigures

    runs: dict[str, list[Path]] = {}
    for folder, summary in found.items():
        runs.setdefault(without_seed(summary_label(summary)), []).append(folder)
    return [
        MethodFigures(
            label=row.label,
            sigma_mean=row.mean("sigma_mean"),
            error=row.mean("error"),
            rotated=row.mean("error_rotated"),
            sigma_max=[x for folder in runs[row.label] for x in _largest(folder / "shapes.csv")],
            failures=sum(int(group.get("failures", 0)) for group in row.groups),
            curves=[found[folder].get("curves") or {} for folder in runs[row.label]],
        )
        for row in benchmark.rows("all")
    ]


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
