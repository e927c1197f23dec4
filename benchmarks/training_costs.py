"""What one optimiser step of every training costs: processor seconds and operations, counted.

A step of a recipe's own networks is taken on a few generated blobs, whose stages before are stood
in for: random weights, images of the icosphere by closest points. Where the recipe's own batch is
too large for that, steps of two small ones are taken, with `SMALL` points of a shape: what they
differ by is the cost of a point, and the rest is that of a shape; both are multiplied up. What
does not grow with the batch (Eqs. 5 and 12) is taken with and without, at fewer points, and
multiplied up. Extractions of level sets are not timed: the points at which one asks the field are
counted, and one evaluation of it is timed.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from lightning import Trainer, seed_everything
from omegaconf import DictConfig
from step_meter import Cost, Meter, Operations
from streaming import build

from gensp.configuration import made, placed
from gensp.files import read_json, write_json
from gensp.geometry.isosurface import extract_surface
from gensp.models import save_model
from gensp.runs import Run

ROOT = Path(__file__).parents[1]
TRAININGS = ("implicit", "initialize", "finetune")
SMALL = ((2, 162), (3, 642))  # levels of icospheres, and their vertices
SHAPES = 3  # of a small batch, S_0 included
_EQ5_VERTICES, _EQ12_POINTS = 400, 16  # of a level set, of a code
_BLOBS = 4
PLAIN = "ablation.geometric_regularization=false"
# Eq. 5 from the first step on, with the level sets that this has extracted.
_ONCE = ("recipe.implicit.regularize_from_epoch=0", "recipe.implicit.level_sets.every=1000")
Row = dict[str, Any]


@dataclass(frozen=True)
class Bench:
    """A folder of stand-ins for the stages before, for one recipe."""

    folder: Path
    recipe: str
    steps: int = 2
    counting: bool = True

    def configured(self, stage: str, *words: str) -> DictConfig:
        """The recipe's settings; few samples are kept, for a step draws its own number of them."""
        few = [f"recipe.implicit.sdf.{kind}=2000" for kind in ("near", "far", "uniform")]
        words = (f"stage={stage}", f"recipe={self.recipe}", "shapes=blobs", "name=costs", *words)
        place = [f"paths.cache={self.folder / 'cache'}", "workers.jobs=1", "recipe.draws=1"]
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            return placed(compose("config", overrides=[*words, *few, *place]))

    def prepare(self, items: int) -> None:
        """Blobs with files of their own, images of them, a tree, random networks."""
        build(self.folder, _BLOBS, items)
        ids = [path.stem for path in sorted((self.folder / "correspond").rglob("*.npz"))]
        tree = {"ids": ["sphere", *ids], "parent": [-1, *[0] * len(ids)]}
        write_json(self.folder / "correspond" / "tree.json", tree)
        seed_everything(0, verbose=False)
        model = self.configured("finetune").model
        networks = {"encoder": made(model.encoder), "generator": made(model.generator)}
        for stage in ("implicit", "initialize"):
            save_model(self.folder / stage / "model.pt", **networks)

    def cost(self, stage: str, *words: str) -> Cost:
        """Of one step: the median of those after the first two."""
        cfg = self.configured(stage, *words)
        stages = ("augment", "implicit", "correspond", "initialize")
        inputs = {name: Run(self.folder / name) for name in stages}
        folder = self.folder / f"{stage}-steps"
        seed_everything(0, verbose=False)
        module = made(cfg.stage.module, inputs=inputs, folder=folder)
        module.compiled = cfg.compile
        data = made(cfg.data, inputs=inputs, folder=folder)
        meter = Meter(counting=self.counting)
        quiet = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
        trainer = Trainer(
            max_steps=2 + self.steps,
            max_epochs=-1,
            accelerator="cpu",
            precision=cfg.trainer.precision,
            callbacks=[meter],
            inference_mode=False,
            **dict.fromkeys(quiet, False),
        )
        trainer.fit(module, datamodule=data)
        return Cost(float(np.median(meter.seconds[-self.steps :])), meter.flops)

    def whole(self, stage: str) -> tuple[Cost, Cost]:
        """A step of the recipe's own batch, and what Eqs. 5 and 12 add; no level set extracted."""
        plain = self.cost(stage, PLAIN)
        return plain, Cost() if stage == "initialize" else self.cost(stage, *_ONCE) - plain

    def scaled(self, stage: str) -> tuple[Cost, Cost]:
        """The same from two small batches, see above."""
        numbers = self.configured(stage).recipe[stage]
        small = [drawn(stage, numbers, *size) for size in SMALL]
        costs = [self.cost(stage, PLAIN, *words) for words in small]
        few, more = (points for _, points in SMALL)
        of_point = 1 / (more - few) * (costs[1] - costs[0])
        of_shape = costs[0] - few * of_point
        wanted = vertices_of(numbers.level) if stage == "finetune" else numbers.points
        step = numbers.batch / SHAPES * (of_shape + wanted * of_point)
        return step, self._derivatives(stage, numbers, small[0], costs[0])

    def _derivatives(
        self, stage: str, numbers: DictConfig, small: Sequence[str], without: Cost
    ) -> Cost:
        """Eq. 5, with an easy level set, or Eq. 12 at fewer points, multiplied up."""
        if stage == "finetune":
            word = f"recipe.finetune.deformation_points={_EQ12_POINTS}"
            factor = numbers.deformation_points / _EQ12_POINTS
            return factor * (self.cost(stage, *small, word) - without)
        if stage == "implicit":
            # As the unit sphere plus something, the random field has a level set.
            easy = ["recipe.model.implicit.sphere_residual=true", *_ONCE]
            sizes = {"resolution": 24, "kept": 1, "vertices": _EQ5_VERTICES}
            easy += [f"recipe.implicit.level_sets.{key}={value}" for key, value in sizes.items()]
            factor = numbers.level_sets.vertices / _EQ5_VERTICES
            return factor * (self.cost(stage, *small, *easy) - without)
        return Cost()

    def level_sets(self, of_point: Cost) -> Cost:
        """What extractions add to a step with Eq. 5; `of_point` is one evaluation of the field."""
        cfg = self.configured("implicit")
        sets, inputs = cfg.recipe.implicit.level_sets, {"augment": Run(self.folder / "augment")}
        bound = made(cfg.data, inputs=inputs, folder=self.folder).bound
        asked = evaluations(sets.resolution, bound)
        return sets.kept * asked / sets.every * of_point

    def evaluation(self) -> Cost:
        """One evaluation of the field, without gradients, of a thousand."""
        field = made(self.configured("implicit").model.implicit)
        z, x = torch.randn(1, field.settings["latent"]), torch.randn(1, 1000, 3)
        with torch.no_grad():
            with Operations() as counter:
                field(z, x)
            began = time.process_time()
            field(z, x)
        seconds = time.process_time() - began
        return 1e-3 * Cost(seconds, float(counter.total))


def drawn(stage: str, numbers: DictConfig, level: int, points: int) -> list[str]:
    """The words for a small batch; Stage IV's points are those of its icosphere."""
    words = [f"recipe.{stage}.batch={SHAPES}", f"recipe.{stage}.points={points}"]
    if stage == "finetune":
        surface = round(numbers.surface_points * points / vertices_of(numbers.level))
        words += [f"recipe.finetune.level={level}", f"recipe.finetune.surface_points={surface}"]
    return words


def vertices_of(level: int) -> int:
    """Of an icosphere."""
    return int(10 * 4**level + 2)


def evaluations(resolution: int, bound: float) -> int:
    """Points at which one extraction asks the field, if its level set is a ball."""
    asked = 0

    def ball(x: torch.Tensor) -> torch.Tensor:
        nonlocal asked
        asked += len(x)
        return x.norm(dim=1) - 1

    extract_surface(ball, resolution=resolution, vertices=None, bounds=bound)
    return asked


def steps_of(numbers: DictConfig, items: int) -> int:
    """Optimiser steps of a training; S_0 opens every batch and is not counted."""
    return int(numbers.epochs * -(-items * numbers.passes // (numbers.batch - 1)))


def trainings(folder: Path, recipe: str, items: int, *, small: bool) -> list[Row]:
    """A row for every training, for a collection of so many items, augmentations included.

    Those that the folder has for this recipe and number of items are kept.
    """
    path = folder / f"trainings-{recipe}-{items}{'-small' if small else ''}.json"
    rows: list[Row] = read_json(path) if path.is_file() else []
    torch.set_num_threads(1)
    bench = Bench(folder / recipe, recipe)
    numbers = bench.configured("implicit").recipe
    largest = SHAPES if small else max(numbers[stage].batch for stage in TRAININGS)
    bench.prepare(max(_BLOBS, largest - 1))
    for stage in TRAININGS[len(rows) :]:
        mine = numbers[stage]
        step, more = bench.scaled(stage) if small else bench.whole(stage)
        share = 1.0
        if stage == "implicit":
            more += bench.level_sets(bench.evaluation())
            share = 1 - mine.regularize_from_epoch / mine.epochs
        row = {"recipe": recipe, "stage": stage, "batch": mine.batch, "items": items}
        row |= {"steps": steps_of(mine, items), "share": share}
        row |= {"seconds": step.seconds, "flops": step.flops}
        rows.append({**row, "more_seconds": more.seconds, "more_flops": more.flops})
        write_json(path, rows)
    return rows
