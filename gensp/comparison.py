"""All variants and methods of one experiment side by side, as Table 1 of the paper."""

from pathlib import Path

from gensp.files import read_json, write_text
from gensp.tables import Comparison, combine_summaries

# The paper's order: the method, its ablations, then the methods it is compared with.
_FIRST = ("full", "no_da", "no_gp", "no_gr")


def compare_variants(experiment: Path) -> Comparison:
    """Write summary.md and summary.csv of an experiment's folder from its finished evaluations.

    Reads every `<variant>/evaluate/summary.json`; a variant that is not evaluated yet is absent.
    """
    paths = sorted(experiment.glob("*/evaluate/summary.json"), key=_place)
    comparison = combine_summaries([read_json(path) for path in paths])
    if paths:
        write_text(experiment / "summary.md", comparison.markdown())
        write_text(experiment / "summary.csv", comparison.csv())
    return comparison


def _place(path: Path) -> tuple[int, str]:
    variant = path.parent.parent.name
    base = variant.split("+")[0]
    return (_FIRST.index(base) if base in _FIRST else len(_FIRST), variant)
