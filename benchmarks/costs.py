"""What every stage costs, and how that grows: processor seconds and bytes on disk.

python benchmarks/costs.py measure --out costs      # minutes
python benchmarks/costs.py pairs --out costs
python benchmarks/costs.py neighbours --out costs
python benchmarks/costs.py augment --out costs
python benchmarks/costs.py evaluate --out costs
python benchmarks/costs.py trainings --out costs --recipe paper --items 24000 --small
python benchmarks/costs.py table --out costs --picture docs/gallery/costs.png

`measure` carries out every stage of experiment=smoke, with few epochs and one worker, on generated
blobs: for each of `--counts` with the second of `--vertices`, and for all of these with the least
count. `pairs` times what looks at pairs of shapes, complete and by neighbours; `neighbours` tells
how near these are to the nearest, see `neighbour_costs.py`. `augment` carries out that stage
alone with `--samples` of every flow; `evaluate` that stage with more and more
partners of every shape, by the numbers of recipe=paper; `trainings` takes steps of a recipe's own
networks, see `training_costs.py`. Every figure is processor time of one thread, so that other work
on the machine hardly counts. `table` prints the first two as Markdown. An exponent p is that of
b·nᵖ, fitted to all sizes; what a stage costs whatever the size lowers it.
"""

import argparse
import resource
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cost_tables import (
    augment_table,
    draw,
    evaluate_table,
    neighbour_table,
    pair_table,
    show,
    stage_table,
    training_table,
)
from hydra import compose, initialize_config_dir
from neighbour_costs import KINDS, neighbours

from gensp.files import read_json, write_json
from gensp.geometry import neighbour_pairs
from gensp.geometry import spanning_tree as trees
from gensp.geometry.neighbour_pairs import degree_norms, nearest_pairs
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.spanning_tree import spanning_tree
from gensp.geometry.sphere import icosphere
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
WORDS = ("measure", "pairs", "neighbours", "augment", "evaluate", "trainings", "table")
# Stage evaluate of recipe=paper.
PAPER_PAIRS = ("recipe.evaluate.level=6", "recipe.evaluate.samples=10000")
Row = dict[str, Any]


def spent() -> float:
    """Processor seconds of this process and of those that it waited for."""
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    times = [resource.getrusage(user) for user in users]
    return sum(used.ru_utime + used.ru_stime for used in times)


def stage_cost(out: Path, name: str, stage: str, words: Sequence[str]) -> Row:
    """Processor seconds of a stage, made anew, and bytes of its folder."""
    words = [f"stage={stage}", f"name={name}", f"paths.runs={out}", *SHORT, *words]
    began = spent()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        run(compose("config", overrides=words), words)
    seconds = spent() - began
    folder = out / name / "full" / stage
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {"stage": stage, "seconds": seconds, "bytes": size}


def collection(count: int, vertices: int) -> list[str]:
    """The words for blobs of which two are held out."""
    return [
        *(f"shapes.count={count}", f"shapes.vertices={vertices}", "shapes.test=2"),
        f"recipe.augment.flow_vertices={2 * vertices}",
        f"recipe.augment.training_vertices={vertices}",
    ]


def stage_rows(out: Path, count: int, vertices: int, name: str = "") -> list[Row]:
    """Cost of all stages on one collection."""
    name, words = name or f"costs-{count}-{vertices}", collection(count, vertices)
    place = {"shapes": count, "vertices": vertices}
    return [{**stage_cost(out, name, stage, words), **place} for stage in ORDER]


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


def augment(out: Path, count: int, vertices: int, samples: Sequence[int]) -> None:
    """Write augment.json: cost of stage augment by the samples that are taken of every flow."""
    words = collection(count, vertices)
    place = {"shapes": count - 2, "vertices": vertices}
    stage_cost(out, "costs-first", "augment", words)  # loops are compiled, blobs are generated
    rows = []
    for number in samples:
        more = [*words, f"recipe.augment.samples={number}"]
        row = stage_cost(out, f"costs-augment-{number}", "augment", more)
        made = out / f"costs-augment-{number}" / "full" / "augment" / "meshes"
        kept = len(list(made.rglob("*@*.npz")))
        rows.append({**row, **place, "samples": number, "augmentations": kept})
    write_json(out / "augment.json", rows)


def evaluate(out: Path, count: int, vertices: int, partners: Sequence[int]) -> None:
    """Write evaluate.json: cost of stage evaluate by the number of pairs, of the same maps."""
    words, rows = collection(count, vertices), []
    for stage in ORDER[:-1]:
        stage_cost(out, "costs-evaluate", stage, words)
    for number in (partners[0], *partners):  # what is compiled or read first counts in none
        more = [*words, *PAPER_PAIRS, f"recipe.evaluate.partners={number}"]
        row = stage_cost(out, "costs-evaluate", "evaluate", more)
        records = (out / "costs-evaluate" / "full" / "evaluate" / "pairs").rglob("*.json")
        found = {(pair["first"], pair["second"]) for path in records for pair in read_json(path)}
        rows.append({**row, "shapes": count, "partners": number, "pairs": len(found)})
    write_json(out / "evaluate.json", rows[1:])


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

    spanning_tree(latent_codes(2100), 0)  # loops are compiled
    for limit, counts in ((10**9, (500, 1000, 2000)), (0, (2000, 8000, 32000))):
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


def main() -> None:
    """One of the words."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("word", choices=WORDS)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--counts", type=int, nargs="+", default=[4, 8, 16])
    parser.add_argument("--vertices", type=int, nargs="+", default=[300, 600, 1200, 2400])
    parser.add_argument("--codes", type=int, nargs="+", default=[8000, 32000, 128000])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help="of codes")
    parser.add_argument("--samples", type=int, nargs="+", default=[2, 6, 18])
    parser.add_argument("--partners", type=int, nargs="+", default=[2, 6, 15])
    parser.add_argument("--recipe", default="smoke")
    parser.add_argument("--items", type=int, default=100, help="of trainings, samples included")
    parser.add_argument("--small", action="store_true", help="small batches, multiplied up")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    out = given.out.resolve()
    if given.word == "measure":
        measure(out, given.counts, given.vertices)
    elif given.word == "pairs":
        pairs(out)
    elif given.word == "neighbours":
        show(neighbour_table(neighbours(out, given.codes, given.kinds)))
    elif given.word == "augment":
        augment(out, min(given.counts), sorted(given.vertices)[1], given.samples)
        show(augment_table(read_json(out / "augment.json")))
    elif given.word == "evaluate":
        evaluate(out, max(given.counts), sorted(given.vertices)[1], given.partners)
        show(evaluate_table(read_json(out / "evaluate.json")))
    elif given.word == "trainings":
        from training_costs import trainings  # imports what trains

        show(training_table(trainings(out, given.recipe, given.items, small=given.small)))
    else:
        rows, pair_rows = (read_json(out / f"{name}.json") for name in ("costs", "pairs"))
        show(stage_table(rows, "shapes"), stage_table(rows, "vertices"), pair_table(pair_rows))
        if given.picture:
            draw(rows, pair_rows, given.picture)


if __name__ == "__main__":
    main()
