"""Curves: the losses of the training stages, and errors as the fraction below a threshold."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gensp.files import atomic_path
from gensp.pictures.montage import SPLIT_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

History = Mapping[str, Sequence[float]]
TITLES = {
    "implicit": "II · implicit generator",
    "initialize": "III-b · generator, from correspondences",
    "finetune": "IV · generator, fine-tuned",
}


def read_history(path: Path) -> dict[str, list[float]]:
    """The columns of a history.csv as numbers; empty cells are not-a-number."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0]) if rows else []
    return {name: [float(row[name] or math.nan) for row in rows] for name in names}


def figure(width: float, height: float) -> "Figure":
    """An empty figure that draws to a picture, with no window behind it."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=110, layout="constrained")


def save_figure(drawing: "Figure", path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; no date or version goes into the file."""
    with atomic_path(path) as temporary:
        drawing.savefig(temporary, format="png", metadata={"Software": None})
    return path


def loss_curves(histories: Mapping[str, History]) -> "Figure":
    """One panel for every training stage: its loss terms; broken, figures of validation shapes."""
    drawing = figure(5.2 * len(histories), 3.8)
    panels = drawing.subplots(1, len(histories), squeeze=False)[0]
    for panel, (stage, history) in zip(panels, histories.items(), strict=True):
        _losses(panel, history)
        panel.set_title(TITLES.get(stage, stage), loc="left", fontsize=11)
    return drawing


# Means over an epoch, and what is measured at some ends of epochs alone.
_LINES: dict[str, dict[str, Any]] = {
    "train": {"linewidth": 1.5},
    "val": {"linewidth": 1.0, "linestyle": "--", "marker": "o", "markersize": 3},
}


def _losses(panel: "Axes", history: History) -> None:
    epochs = history.get("epoch", range(len(next(iter(history.values())))))
    for name, values in history.items():
        kind, drawn = name.split("/")[0], np.array(values, dtype=float)
        # A share of steps is no loss.
        if kind not in _LINES or name.endswith("_share") or not (drawn > 0).any():
            continue
        label = name.removeprefix("train/").replace("/", " ").replace("_", " ")
        # A logarithmic axis has no place for zeros; a term may begin late.
        shown = drawn > 0
        panel.plot(np.array(epochs)[shown], drawn[shown], label=label, **_LINES[kind])
    panel.set_yscale("log")
    panel.set_xlabel("epoch")
    plain(panel, legend=False)
    # Lines cross the whole panel: there is no place for a legend in it.
    panel.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))


_ERROR_LINES = {
    "raw": ("-", ""),
    "rotated": (":", ", best rotation"),
    "registered": ("--", ", registered"),
}


def error_curves(curves: Mapping[str, Any]) -> "Figure":
    """Fraction of points whose implied correspondence is closer than x (a summary's curves)."""
    drawing = figure(6.4, 4.2)
    panel = drawing.subplots()
    for split, lines in curves.items():
        if split == "thresholds":
            continue
        colour = np.array(SPLIT_COLOURS.get(split, (60, 60, 60))) / 255
        for kind, (style, words) in _ERROR_LINES.items():
            if lines.get(kind):
                label = split + words
                panel.plot(curves["thresholds"], lines[kind], style, color=colour, label=label)
    panel.set(xlabel="error / √area", ylabel="fraction of points below", ylim=(0, 1.02))
    panel.set_xlim(left=0)
    plain(panel)
    return drawing


def decade_ticks(axis: "Axis") -> None:
    """Plain numbers at 1, 2 and 5 of every decade of a logarithmic axis, and none between."""
    from matplotlib.ticker import LogLocator

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def plain(panel: "Axes", *, legend: bool = True) -> None:
    """A panel without frame, with a pale grid and a legend of its lines."""
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#e6e6ea", linewidth=0.8)
    if legend and panel.lines:
        panel.legend(frameon=False, fontsize=8)
