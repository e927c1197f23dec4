"""What one edge, one pair and one map cost by the numbers of a recipe, at prepared sizes.

OMP_NUM_THREADS=1 python benchmarks/item_costs.py --out items --recipe paper

Four heads of `--vertices` vertices (5,000 at most), one of them held out, go through the stages
with trainings of a few steps of few points: what a network costs does not depend on its weights,
and as the unit sphere plus something the field has level sets from the start. Then every kind of
item is done by its own task, as the stages do it, with the recipe's networks and numbers; only the
ladder of an edge ends at its first rung. Edges lead from one head to another, both of `--vertices`
vertices; meshes of fewer (`--sizes`) are joined too, and an exponent is fitted. Of the level sets
between them one is made: what it adds is to be taken as often as the recipe asks for. Maps begin
from what so short a training predicts, so that Newton has more to do than after a whole one. Every
figure is processor time of one thread; loading what is compiled counts in none.
"""

import argparse
import itertools
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from cost_tables import exponent, plain, show
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from gensp.configuration import made, placed
from gensp.files import write_json
from gensp.geometry.mesh import Mesh, load_mesh, save_mesh, simplify
from gensp.run import run
from gensp.runs import Run
from gensp.tasks.correspond import RegisterEdge, is_input

ROOT = Path(__file__).parents[1]
HEADS = ("id001_neutral", "id002_neutral", "id007_neutral", "id013_neutral")
# Trainings of a few steps; the flow by one of its candidates, and one sample of it.
SHORT = (
    "recipe.augment.samples=1",
    "recipe.augment.candidates=[{first: 0.05, growth: 1.0, largest: 0.05}]",
    "recipe.implicit.sdf={near: 2000, far: 1000, uniform: 1000}",
    *("recipe.implicit.batch=4", "recipe.implicit.points=256", "recipe.implicit.epochs=12"),
    *("recipe.implicit.regularize_from_epoch=12", "recipe.model.implicit.sphere_residual=true"),
    *("recipe.initialize.batch=4", "recipe.initialize.points=256", "recipe.initialize.epochs=12"),
    *("recipe.initialize.passes=1", "recipe.finetune.passes=1", "recipe.finetune.epochs=1"),
    *("recipe.finetune.batch=3", "recipe.finetune.points=64", "recipe.finetune.level=2"),
    *("recipe.finetune.surface_points=32", "recipe.finetune.deformation_codes=1"),
    *("recipe.finetune.deformation_points=8", "recipe.draws=1"),
    *("callbacks.validation.times=0", "workers.jobs=1", "threads=1", "logger=none"),
)
ITEMS_ONLY = tuple(word for word in SHORT if not word.startswith("callbacks.validation"))
# The stage is there for the networks of the maps: a few short registrations carry the sphere.
QUICK_EDGES = (
    "recipe.correspond.registration.interpolants=0",
    *("recipe.correspond.retries=[]", "recipe.correspond.max_failures=100"),
    "recipe.correspond.acceptance={residual: 10, coverage: 10, fold_rate: 1}",
    *("recipe.correspond.neighbours=1", "recipe.correspond.rounds=0"),
)
Row = dict[str, Any]


@dataclass(frozen=True)
class Bench:
    """Runs below one folder, by one recipe."""

    out: Path
    recipe: str
    vertices: int

    def words(self, stage: str, kind: str, *more: str) -> list[str]:
        """The words of a stage; either kind of correspondences has a run of its own."""
        few = SHORT if stage in ("implicit", "initialize", "finetune") else ITEMS_ONLY
        shapes = ("shapes=folder", f"shapes.root={self.out / f'heads-{self.vertices}'}")
        place = (f"paths.runs={self.out / 'runs'}", f"paths.cache={self.out / 'cache'}")
        name = (f"name={self.recipe}-{kind}", f"recipe={self.recipe}", f"correspond={kind}")
        made_once = self.folder("tree")
        # What leads maps of fit=guided is the surface that all share: a single epoch will do.
        brief = ("recipe.initialize.epochs=1",)
        shared = [f"inputs.{name}={made_once / name}" for name in ("augment", "implicit")]
        return [
            f"stage={stage}",
            *(*name, *shapes, *place, *few),
            *((*shared, *brief) if kind == "paired" else ()),
            *more,
        ]

    def folder(self, kind: str) -> Path:
        """Of a run."""
        return self.out / "runs" / f"{self.recipe}-{kind}" / "full"

    def configured(self, *words: str) -> DictConfig:
        """Settings of a stage."""
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            return placed(compose("config", overrides=list(words)))

    def collect(self) -> None:
        """A folder of the heads; the last is held out."""
        folder = self.out / f"heads-{self.vertices}"
        lines = ["file,split"]
        for id in HEADS:
            mesh = load_mesh(ROOT / "data" / "heads" / "meshes" / f"{id}.ply")
            save_mesh(simplify(mesh, self.vertices), folder / "meshes" / f"{id}.ply")
            lines.append(f"meshes/{id}.ply,{'test' if id == HEADS[-1] else 'train'}")
        (folder / "manifest.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")

    def prepare(self, kind: str) -> None:
        """Stages up to the product; what is finished is not made again."""
        stages = ("augment", "implicit", "correspond", "initialize", "finetune")
        for stage in stages if kind == "tree" else stages[2:]:
            words = self.words(stage, kind, *QUICK_EDGES)
            with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
                run(compose("config", overrides=words), words)

    def inputs(self, kind: str) -> dict[str, Run]:
        """The stages before."""
        known = {name: Run(self.folder("tree") / name) for name in ("augment", "implicit")}
        return known | {"finetune": Run(self.folder(kind) / "finetune")}

    def edges(self, sizes: Sequence[int]) -> list[Row]:
        """Seconds of one edge, without level sets at every size, with one of them at the last."""
        cfg = self.configured(*self.words("correspond", "tree"))
        folder = self.out / f"{self.recipe}-edges"
        task = made(cfg.correspond.task, inputs=self.inputs("tree"), folder=folder)
        rows = [edge(task, 0, size) for size in (sizes[0], *sizes)]
        if task.ladder[0].interpolants:
            rows.append(edge(task, 1, sizes[-1]))
        return rows[1:]  # what the first compiles counts in none

    def pairs(self) -> list[Row]:
        """Seconds of one pair, both ways, and of the map of one input that leads it."""
        cfg = self.configured(*self.words("correspond", "paired"))
        folder = self.out / f"{self.recipe}-pairs"
        shutil.rmtree(folder, ignore_errors=True)  # maps that were kept would cost nothing
        task = made(cfg.correspond.task, inputs=self.inputs("paired"), folder=folder)
        guides = [timed(partial(task.shape, id))[1] for id in task.ids]
        seconds = timed(lambda: task("/".join(task.ids[1:3])))[1]
        size = {"vertices": len(task.shape(task.ids[1]).mesh.vertices)}
        return [
            {"what": "own map of an input", **size, "seconds": guides[1]},
            {"what": "pair, both ways", **size, "seconds": seconds},
        ]

    def maps(self, kind: str, fits: Sequence[str]) -> list[Row]:
        """Seconds of the map of the shape that is held out, by every fit and refinement."""
        rows = []
        for fit, refine in itertools.product(fits, ("newton", "certify")):
            words = self.words("parameterize", kind, f"fit={fit}", f"refine={refine}")
            folder = self.out / f"{self.recipe}-maps" / f"{fit}-{refine}"
            cfg = self.configured(*words)
            task = made(cfg.data, inputs=self.inputs(kind), folder=folder).task
            seconds = task(task.collection.ids("test")[0])["processor_seconds"]
            row = {"what": f"map, fit={fit} refine={refine}", "vertices": self.vertices}
            rows.append({**row, "seconds": seconds})
        return rows


@dataclass(frozen=True)
class SizedEdge(RegisterEdge):
    """An edge between two inputs, simplified to so many vertices."""

    size: int

    def mesh(self, id: str) -> Mesh:
        """Mesh of a node."""
        return simplify(super().mesh(id), self.size)


def edge(task: RegisterEdge, interpolants: int, size: int) -> Row:
    """The first rung of the ladder between the first two inputs."""
    rung = replace(task.ladder[0], interpolants=interpolants)
    given = {field.name: getattr(task, field.name) for field in fields(task)}
    sized = SizedEdge(**{**given, "ladder": (rung,)}, size=size)
    parent, child = [id for id in task.shapes.ids if is_input(id)][:2]
    row, seconds = timed(lambda: sized.join(child, parent))
    what = f"edge, {row['interpolants']} level set" if interpolants else "edge, no level set"
    # A recipe hands on meshes of a size of its own, which may be smaller.
    return {"what": what, "vertices": len(sized.mesh(child).vertices), "seconds": seconds}


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and its processor seconds."""
    began = time.process_time()
    found = work()
    return found, time.process_time() - began


def table(rows: Sequence[Row]) -> list[str]:
    """A line for every kind of item; an exponent where there are several sizes."""
    lines = ["| item | vertices: processor seconds | exponent |", "|---|---|---|"]
    for what in dict.fromkeys(row["what"] for row in rows):
        chosen = [row for row in rows if row["what"] == what]
        sizes, costs = ([row[key] for row in chosen] for key in ("vertices", "seconds"))
        shown = ", ".join(f"{n:,}: {plain(s)}" for n, s in zip(sizes, costs, strict=True))
        grows = f"{exponent(sizes, costs):.2f}" if len(costs) > 1 else ""
        lines.append(f"| {what} | {shown} | {grows} |")
    return lines


def main() -> None:
    """Measure the parts and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--recipe", default="paper")
    parser.add_argument("--vertices", type=int, default=5000)
    parser.add_argument("--sizes", type=int, nargs="+", help="of edges; the last is --vertices")
    parser.add_argument("--parts", nargs="+", choices=("edges", "maps", "pairs", "guided"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    bench = Bench(given.out.resolve(), given.recipe, given.vertices)
    sizes = given.sizes or [given.vertices // 4, given.vertices // 2, given.vertices]
    bench.collect()
    parts = {
        "edges": lambda: bench.edges(sizes),
        "maps": lambda: bench.maps("tree", ("none", "register")),
        "pairs": bench.pairs,
        "guided": lambda: bench.maps("paired", ("guided",)),
    }
    for name in given.parts or parts:
        bench.prepare("paired" if name == "guided" else "tree")
        rows = parts[name]()
        write_json(bench.out / f"{given.recipe}-{given.vertices}-{name}.json", rows)
        show(table(rows))


if __name__ == "__main__":
    main()
