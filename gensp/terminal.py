"""What a run says: a head line for every stage, its end, errors in one line."""

import sys
import time
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from rich.console import Console
from rich.markup import escape

from gensp.comparison import compare_methods, compare_variants
from gensp.files import near, read_json
from gensp.machine import first_process, rank
from gensp.tables import rich_table

STAGES = {
    "prepare": "raw meshes to a collection",
    "augment": "flows to the sphere (I)",
    "implicit": "encoder and implicit field (II)",
    "correspond": "registrations along the tree (III-a)",
    "initialize": "generator from correspondences (III-b)",
    "finetune": "generator and encoder together (IV)",
    "parameterize": "maps of all shapes",
    "evaluate": "table, pictures, report",
}
_SHOWN = (
    "manifest.csv",
    "dropped.csv",
    "CARD.md",
    "maps",
    "summary.md",
    "pictures",
    "report.html",
)

_PATIENCE = 3.0  # seconds in which torchrun, srun or Lightning end ranks whose first has failed

# A log file has room for the whole table.
console = Console(highlight=False, width=None if Console().is_terminal else 140)
Words = ParamSpec("Words")


def once(speak: Callable[Words, None]) -> Callable[Words, None]:
    """Let rank zero alone speak."""

    @wraps(speak)
    def spoken(*words: Words.args, **options: Words.kwargs) -> None:
        if first_process():
            speak(*words, **options)

    return spoken


@once
def say(text: str) -> None:
    """One line, on rank zero."""
    console.print(text, soft_wrap=True)


@once
def warn(text: str) -> None:
    """One line on what a run goes on without, on rank zero."""
    console.print(f"      [yellow]warning:[/yellow] {escape(text)}", soft_wrap=True)


def complain(line: str, *, of_all: bool = False) -> None:
    """What went wrong, on the error stream; ranks behind the first name themselves.

    These hold their tongue for a moment: where the first has met the same, it has told so by then,
    and what started the ranks has ended them.

    Parameters
    ----------
    of_all
        Whether all ranks meet it together: then the first alone tells it.
    """
    first = first_process()
    if not first:
        time.sleep(_PATIENCE)
    if first or not of_all:
        sys.stderr.write(f"error: {line}\n" if first else f"error: rank {rank()}: {line}\n")


def announce(stage: str, folder: Path, place: str = "") -> None:
    """The head line of a stage."""
    numbered = f"\\[{place}] " if place else ""
    say(f"[bold]{numbered}{stage}[/bold] · {STAGES.get(stage, '')} · {folder}")


def report(folder: Path, metrics: Mapping[str, Any], seconds: float) -> None:
    """The end of a stage: time, first metrics, the table and the paths of what was made."""
    shown = " · ".join(f"{name} {value:.4g}" for name, value in list(metrics.items())[:6])
    say(f"      done in {seconds:.1f} s · {shown}")
    if (folder / "summary.json").is_file():
        console.print(rich_table(read_json(folder / "summary.json")))
    for name in _SHOWN:
        if (folder / name).exists():
            say(f"      {near(folder / name)}")


@once
def show_variants(experiment: Path) -> None:
    """The end of a pipeline: all variants and methods of the experiment, split by split."""
    comparison = compare_variants(experiment)
    if len(comparison.summaries) < 2:
        return
    for split in comparison.splits:
        console.print(comparison.rich(split))
    say(f"      {experiment / 'summary.md'}")


@once
def show_methods(experiment: Path) -> None:
    """The end of an evaluation: tables and plot of all methods that the experiment has."""
    written = compare_methods(experiment)
    if written:
        say(f"      {' '.join(map(str, written))}")
