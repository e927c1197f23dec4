"""Tables and pictures of what `costs.py` measured."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from gensp.pictures.curves import decade_ticks, figure, save_figure
from gensp.sweeps import ORDER

Row = dict[str, Any]


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Slope of the costs over the sizes, both as logarithms, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def series(rows: Sequence[Row], along: str, stage: str, what: str) -> list[tuple[int, float]]:
    """Sizes and costs of a stage along one of the two directions."""
    other = "vertices" if along == "shapes" else "shapes"
    fixed = sorted(row[other] for row in rows)
    fixed_at = max(set(fixed), key=fixed.count)
    chosen = [row for row in rows if row["stage"] == stage and row[other] == fixed_at]
    return sorted((row[along], row[what]) for row in chosen)


def stage_table(rows: Sequence[Row], along: str) -> list[str]:
    """A line for every stage: costs at all sizes, exponents, cost of one more."""
    sizes = [size for size, _ in series(rows, along, ORDER[0], "seconds")]
    heads = [f"{size} {along}" for size in sizes]
    lines = [f"| stage | {' | '.join(heads)} | exponent | each | exponent of bytes | bytes each |"]
    lines.append("|---|" + "---|" * (len(sizes) + 4))
    for stage in ORDER:
        cells = []
        for what, form in (("seconds", ".3g"), ("bytes", ",.0f")):
            costs = [cost for _, cost in series(rows, along, stage, what)]
            each = (costs[-1] - costs[0]) / (sizes[-1] - sizes[0])
            cells.append((costs, f"{exponent(sizes, costs):.2f}", format(each, form)))
        seconds = [f"{cost:.1f}" for cost in cells[0][0]]
        lines.append(f"| {' | '.join([stage, *seconds, *cells[0][1:], *cells[1][1:]])} |")
    return lines


def pair_table(rows: Sequence[Row]) -> list[str]:
    """A line for everything that looks at pairs."""
    lines = ["| what | shapes: seconds | exponent |", "|---|---|---|"]
    for what in dict.fromkeys(row["what"] for row in rows):
        chosen = [row for row in rows if row["what"] == what]
        costs = [row["seconds"] for row in chosen]
        sizes = [row["shapes"] for row in chosen]
        grows = f"{exponent(sizes, costs):.2f}" if len(costs) > 1 else ""
        shown = ", ".join(f"{row['shapes']:,}: {row['seconds']:.3g}" for row in chosen)
        lines.append(f"| {what} | {shown} | {grows} |")
    return lines


def neighbour_table(rows: Sequence[Row]) -> list[str]:
    """A line for every kind of codes: recall, weight of the tree, seconds."""
    sizes = list(dict.fromkeys(row["codes"] for row in rows))
    heads = ["codes", *(f"recall, {size:,}" for size in sizes), f"weight, {sizes[0]:,}"]
    heads += [f"{what}, {size:,}" for what in ("neighbours", "tree") for size in sizes]
    lines = [f"| {' | '.join([*heads, 'exponent'])} |", "|---|" + "---|" * len(heads)]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        chosen = [row for row in rows if row["kind"] == kind]
        cells = [kind, *(f"{row['recall']:.3f}" for row in chosen)]
        cells += [f"{chosen[0]['weight'] / chosen[0]['least']:.4f}"]
        cells += [plain(row[what]) for what in ("seconds", "tree_seconds") for row in chosen]
        grows = exponent(sizes, [row["tree_seconds"] for row in chosen])
        lines.append(f"| {' | '.join([*cells, f'{grows:.2f}'])} |")
    return lines


def augment_table(rows: Sequence[Row]) -> list[str]:
    """What one augmentation costs."""
    counts = [row["augmentations"] for row in rows]
    heads = [f"{row['samples']} of each" for row in rows]
    lines = [f"| of {rows[0]['shapes']} flows | {' | '.join(heads)} | exponent | each |"]
    lines += ["|---|" + "---|" * (len(rows) + 2)]
    lines += [f"| augmentations | {' | '.join(map(str, counts))} | | |"]
    for what, form in (("seconds", ".3g"), ("bytes", ",.0f")):
        costs = [row[what] for row in rows]
        each = (costs[-1] - costs[0]) / (counts[-1] - counts[0])
        cells = [*(format(cost, form) for cost in costs), f"{exponent(counts, costs):.2f}"]
        lines.append(f"| {' | '.join([what, *cells, format(each, form)])} |")
    return lines


def plain(value: float) -> str:
    """Three digits, or all before the point, without powers of ten where they can be spared."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def evaluate_table(rows: Sequence[Row]) -> list[str]:
    """What one pair costs."""
    pairs = [row["pairs"] for row in rows]
    lines = [
        f"| of {rows[0]['shapes']} shapes | {' | '.join(f'{n} pairs' for n in pairs)} | each |"
    ]
    lines += ["|---|" + "---|" * (len(rows) + 1)]
    for what, form in (("seconds", ".3g"), ("bytes", ",.0f")):
        costs = [row[what] for row in rows]
        each = (costs[-1] - costs[0]) / (pairs[-1] - pairs[0])
        cells = [format(cost, form) for cost in (*costs, each)]
        lines.append(f"| {' | '.join([what, *cells])} |")
    return lines


def training_table(rows: Sequence[Row]) -> list[str]:
    """A line for every training; "+" is what Eqs. 5 and 12 add where they take part."""
    heads = ("training", "items", "batch", "steps", "TFLOP a step", "seconds a step")
    heads = (*heads, "a shape of it", "core hours", "PFLOP")
    lines = [f"| {' | '.join(heads)} |", "|---|" + "---|" * (len(heads) - 1)]
    for row in rows:
        costs = []
        for what, unit in (("flops", 1e12), ("seconds", 1.0)):
            own, more = row[what] / unit, row[f"more_{what}"] / unit
            shown = f"{plain(own)} + {plain(more)}" if more else plain(own)
            costs.append((shown, own, row["steps"] * (own + row["share"] * more)))
        name = f"{row['stage']}, recipe={row['recipe']}"
        cells = (name, f"{row['items']:,}", row["batch"], f"{row['steps']:,}")
        each = plain(costs[1][1] / row["batch"])
        totals = plain(costs[1][2] / 3600), plain(costs[0][2] / 1000)
        line = (*cells, costs[0][0], costs[1][0], each, *totals)
        lines.append(f"| {' | '.join(map(str, line))} |")
    return lines


def draw(rows: Sequence[Row], pair_rows: Sequence[Row], path: Path) -> None:
    """Seconds over shapes, over vertices, and of what looks at pairs; all on logarithmic axes."""
    drawing = figure(14, 4.2)
    panels = drawing.subplots(1, 3)
    for panel, along in zip(panels, ("shapes", "vertices"), strict=False):
        for stage in ORDER:
            points = zip(*series(rows, along, stage, "seconds"), strict=True)
            panel.loglog(*points, "o-", label=stage)
        panel.set(xlabel=along, ylabel="processor seconds")
    for what in dict.fromkeys(row["what"] for row in pair_rows if row["shapes"] > 2):
        chosen = [(row["shapes"], row["seconds"]) for row in pair_rows if row["what"] == what]
        panels[2].loglog(*zip(*chosen, strict=True), "o-", label=what)
    panels[2].set(xlabel="shapes")
    for panel in panels:
        decade_ticks(panel.xaxis)
        decade_ticks(panel.yaxis)
    for panel, corner in ((panels[0], "upper left"), (panels[2], "lower right")):
        panel.legend(fontsize=7, loc=corner)
    save_figure(drawing, path)


def show(*tables: Sequence[str]) -> None:
    """Print Markdown."""
    console = Console(file=sys.stdout, soft_wrap=True)
    text = "\n\n".join("\n".join(lines) for lines in tables)
    console.print(text, markup=False, highlight=False)
