"""What every stage costs, and how that grows: processor seconds and bytes on disk.

python benchmarks/costs.py measure --out costs      # minutes
python benchmarks/costs.py pairs --out costs
python benchmarks/costs.py table --out costs --picture docs/gallery/costs.png

`measure` carries out every stage of experiment=smoke, with few epochs and one worker, on generated
blobs: for each of `--counts` with the second of `--vertices`, and for all of these with the least
count. `pairs` times what looks at pairs of shapes, complete and by neighbours. Every figure is
processor time of one thread, so that other work on the machine hardly counts. `table` prints both
as Markdown. An exponent p is that of b·nᵖ, fitted to all sizes; what a stage costs whatever the
size lowers it.
"""

import argparse
import resource
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from hydra import compose, initialize_config_dir
from rich.console import Console

from gensp.files import read_json, write_json
from gensp.geometry import neighbour_pairs
from gensp.geometry import spanning_tree as trees
from gensp.geometry.neighbour_pairs import degree_norms, nearest_pairs
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.spanning_tree import spanning_tree
from gensp.geometry.sphere import icosphere
from gensp.pictures.curves import figure, save_figure
from gensp.run import run
from gensp.sweeps import ORDER

ROOT = Path(__file__).parents[1]
# As short as trainings can be; their cost is that of a step times their number.
SHORT = (
    *("recipe.implicit.epochs=4", "recipe.implicit.regularize_from_epoch=2"),
    *("recipe.initialize.epochs=4", "recipe.finetune.epochs=2"),
    *("recipe.correspond.max_failures=1000", "recipe.parameterize.max_failures=1000"),
    # Of a call that was interrupted nothing is kept: what is finished would cost nothing.
    *("force=true", "workers.jobs=1", "threads=1", "logger=none", "experiment=smoke"),
)
Row = dict[str, Any]


def spent() -> float:
    """Processor seconds of this process and of those that it waited for."""
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    times = [resource.getrusage(user) for user in users]
    return sum(used.ru_utime + used.ru_stime for used in times)


def stage_rows(out: Path, count: int, vertices: int, name: str = "") -> list[Row]:
    """Cost of all stages on one collection."""
    name, rows = name or f"costs-{count}-{vertices}", []
    for stage in ORDER:
        words = [
            *(f"stage={stage}", f"name={name}", f"paths.runs={out}", *SHORT),
            *(f"shapes.count={count}", f"shapes.vertices={vertices}", "shapes.test=2"),
            f"recipe.augment.flow_vertices={2 * vertices}",
            f"recipe.augment.training_vertices={vertices}",
        ]
        began = spent()
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            run(compose("config", overrides=words), words)
        folder = out / name / "full" / stage
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        row = {"stage": stage, "shapes": count, "vertices": vertices}
        rows.append({**row, "seconds": spent() - began, "bytes": size})
    return rows


def measure(out: Path, counts: Sequence[int], vertices: Sequence[int]) -> None:
    """Write costs.json, a collection after the other; those that it has are kept."""
    path, least = out / "costs.json", min(counts)
    rows: list[Row] = read_json(path) if path.is_file() else []
    # Loops are compiled and files are read when first used.
    stage_rows(out, least, min(vertices), "costs-first")
    middle = sorted(vertices)[1]
    for size in [*((k, middle) for k in counts), *((least, n) for n in vertices)]:
        if not any((row["shapes"], row["vertices"]) == size for row in rows):
            rows += stage_rows(out, *size)
            write_json(path, rows)


def timed(work: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def latent_codes(count: int) -> np.ndarray:
    """Codes in 64 dimensions of a collection with eight degrees of freedom."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((count, 8)) @ rng.standard_normal((8, 64))


def pairs(out: Path) -> None:
    """Write pairs.json: seconds of trees, neighbours and agreements for several numbers."""
    rows: list[Row] = []

    def note(what: str, count: int, work: Callable[[], object]) -> None:
        rows.append({"what": what, "shapes": count, "seconds": timed(work)})

    for limit, counts in ((10**9, (500, 1000, 2000)), (0, (2000, 4000, 8000))):
        kind = "neighbours" if limit == 0 else "all pairs"
        trees.ALL_PAIRS = neighbour_pairs.ALL_PAIRS = limit
        for count in counts:
            codes = latent_codes(count)
            note(f"minimum tree, {kind}", count, partial(spanning_tree, codes, 0))
            note(f"nearest 4, {kind}", count, partial(nearest_pairs, codes, 4))
    rng, ball = np.random.default_rng(0), icosphere(3)
    middles = ball.vertices[ball.faces].mean(axis=1)
    signals = [
        density_signal(ball.vertices, ball.faces, np.exp(middles @ rng.normal(size=3)))
        for _ in range(20)
    ]
    some = [(i, j) for i in range(20) for j in range(i)][:40]
    turns = timed(
        lambda: [register_rotation(signals[i], signals[j], candidates=1) for i, j in some]
    )
    rows.append({"what": "agreement of one pair of maps", "shapes": 2, "seconds": turns / 40})
    for count in (1000, 2000, 4000):
        norms = degree_norms(signals)[rng.integers(20, size=count)]
        norms = np.abs(norms + 0.05 * rng.standard_normal(norms.shape))
        note("candidates for agreement", count, partial(nearest_pairs, norms, 64))
    write_json(out / "pairs.json", rows)


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
    for panel in panels[[0, 2]]:
        panel.legend(fontsize=7)
    save_figure(drawing, path)


def main() -> None:
    """One of the three words."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("word", choices=("measure", "pairs", "table"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--counts", type=int, nargs="+", default=[4, 8, 16])
    parser.add_argument("--vertices", type=int, nargs="+", default=[300, 600, 1200, 2400])
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    if given.word == "measure":
        measure(given.out.resolve(), given.counts, given.vertices)
    elif given.word == "pairs":
        pairs(given.out)
    else:
        rows, pair_rows = (read_json(given.out / f"{name}.json") for name in ("costs", "pairs"))
        tables = [
            stage_table(rows, "shapes"),
            stage_table(rows, "vertices"),
            pair_table(pair_rows),
        ]
        console = Console(file=sys.stdout, soft_wrap=True)
        text = "\n\n".join("\n".join(lines) for lines in tables)
        console.print(text, markup=False, highlight=False)
        if given.picture:
            draw(rows, pair_rows, given.picture)


if __name__ == "__main__":
    main()
