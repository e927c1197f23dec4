"""Memory of a training, and how long its steps wait for the loader, for few and many shapes.

python benchmarks/streaming.py --out streaming

A collection of `--shapes` generated blobs is repeated until it has `--sizes` items, each with
files of its own. For every size and stage a fresh process trains `--steps` steps of the size of
recipe=quick. Printed are the largest resident memory while it trained (`anon`: what cannot be read
again from files; `all`: with mapped files and libraries), and the share of its time for which the
training waited for its next batch. An epoch has as many steps in all sizes (`passes`), and is
over within none of them; with `--validation yes` it is cut into four, after each of which the
stage's callback measures four shapes.
"""

import argparse
import itertools
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning import Callback, LightningDataModule, LightningModule, Trainer, seed_everything
from rich.console import Console

from gensp.data.blobs import BlobFamily, generate_blobs
from gensp.data.fitting import Batching
from gensp.data.items import item_path
from gensp.data.loading import AheadLoader
from gensp.data.sdf import SdfSampler
from gensp.data.shapes import ShapeCollection
from gensp.data.training import CorrespondenceModule, SdfModule
from gensp.files import read_json, save_npz, write_json
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import load_mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.models import AnchoredGenerator, ImplicitField, PointNet2Encoder
from gensp.runs import Run
from gensp.stages.generator import FinetuneStage, InitializeStage, Surfaces
from gensp.stages.implicit import ImplicitStage, LevelSetSampling
from gensp.stages.validation import DistanceValidation, GeneratorValidation

LATENT = 64
LAYERS = {"width": 128, "inject": [3], "activation": "silu"}
COLUMNS = (
    *("stage", "validation", "shapes", "steps"),
    *("anon (MiB)", "all (MiB)", "wait", "step (ms)"),
)
VALIDATIONS = 4


def build(folder: Path, shapes: int, size: int) -> None:
    """Results of the stages `augment` and `correspond` for a collection of repeated blobs."""
    family = generate_blobs(folder / "cache", BlobFamily(count=shapes, test=0))
    ball = icosphere(3).vertices
    meshes = [normalize(load_mesh(path)) for path in sorted(family.rglob("*.ply"))]
    images = [closest_point(ball, mesh).points for mesh in meshes]
    ids = []
    for k in range(size):
        mesh, image = meshes[k % shapes], images[k % shapes]
        # The first of each are known to the collection that validation asks.
        ids.append(f"{mesh.name}-{k // shapes}" if k >= shapes else mesh.name)
        item = item_path(folder / "augment", ids[-1])
        save_npz(item, vertices=mesh.vertices, faces=mesh.faces)
        carried = folder / "correspond" / "correspondences" / f"{ids[-1]}.npz"
        save_npz(carried, points=image, valid=np.ones(len(image), dtype=bool))
    entry = {"split": "train", "kind": "input", "t": 0.0}
    write_json(folder / "augment" / "items.json", [{"id": i, "shape": i, **entry} for i in ids])


def runs(folder: Path) -> dict[str, Run]:
    """The stages before, as a stage reads them."""
    return {name: Run(folder / name) for name in ("augment", "correspond")}


def implicit(folder: Path, passes: int) -> tuple[LightningModule, LightningDataModule]:
    """Stage II with Eq. 5 from the first step."""
    data = SdfModule.from_runs(
        runs(folder),
        folder,
        augmented=True,
        batching=Batching(size=16, points=384, passes=passes, cloud=1024, draws=2),
        sampler=SdfSampler(),
        cache=folder / "cache",
    )
    stage = ImplicitStage(
        encoder=encoder(),
        field=ImplicitField(LATENT, depth=6, octaves=4, **LAYERS),
        norm="l1",
        tolerance=0.0,
        encoder_weight=1e-3,
        penalize="latents",
        origin_weight=0.1,
        deformation_weight=0.01,
        geometric_regularization=True,
        regularize_from_epoch=0,
        sampling=LevelSetSampling(vertices=500, nodes=60, directions=4, resolution=32),
        learning_rate=2e-3,
        folder=folder / "implicit",
    )
    return stage, data


def initialize(folder: Path, passes: int) -> tuple[LightningModule, LightningDataModule]:
    """Stage III-b, which encodes all items before its first step."""
    batching = Batching(size=16, points=320, passes=passes, cloud=1024, draws=2)
    data = CorrespondenceModule.from_runs(
        runs(folder), folder, batching=batching, store=folder / "cache"
    )
    stage = InitializeStage(
        encoder=encoder(),
        generator=generator(),
        latent_spread=2.0,
        learning_rate=5e-3,
        folder=folder / "initialize",
    )
    return stage, data


def finetune(folder: Path, passes: int) -> tuple[LightningModule, LightningDataModule]:
    """Stage IV with the encoder trained too."""
    batching = Batching(
        size=16, points=512, surface_points=256, passes=passes, cloud=1024, draws=2
    )
    data = CorrespondenceModule.from_runs(
        runs(folder), folder, batching=batching, store=folder / "cache"
    )
    stage = FinetuneStage(
        encoder=encoder(),
        generator=generator(),
        surfaces=Surfaces(folder / "augment"),
        parents=dict.fromkeys(data.ids[1:], "sphere"),
        train_encoder=True,
        deformation_weight=5e-3,
        isometry_weight=0.01,
        geometric_regularization=True,
        deformation_codes=2,
        deformation_points=64,
        correspondence_weight=1.0,
        final_correspondence_weight=0.3,
        coverage_weight=0.5,
        level=3,
        learning_rate=1e-3,
        folder=folder / "finetune",
    )
    return stage, data


STAGES = {"implicit": implicit, "initialize": initialize, "finetune": finetune}


def encoder() -> PointNet2Encoder:
    """recipe=quick's, from seed 0."""
    seed_everything(0, verbose=False)
    return PointNet2Encoder(LATENT, width=32, groups=[[128, 16], [32, 16]])


def generator() -> AnchoredGenerator:
    """recipe=quick's."""
    return AnchoredGenerator(LATENT, form="blend", rank=16, depth=4, octaves=3, **LAYERS)


def validation(name: str, folder: Path, shapes: int) -> Callback:
    """What the stage's own configuration adds, at the end of every epoch."""
    collection = ShapeCollection.from_blobs(folder / "cache", count=shapes, test=0)
    kind = DistanceValidation if name == "implicit" else GeneratorValidation
    return kind(collection=collection, times=1)


class Meter(Callback):
    """Memory while training, and seconds in steps and in waiting for the loader."""

    def __init__(self) -> None:
        self.anon = self.resident = 0.0
        self.step = self.wait = self._began = 0.0

    def on_train_batch_start(self, *_: Any) -> None:
        """A step begins."""
        self._began = time.perf_counter()

    def on_train_batch_end(self, *_: Any) -> None:
        """A step ends; memory is read outside of its time."""
        self.step += time.perf_counter() - self._began
        self._look()

    def on_train_epoch_end(self, *_: Any) -> None:
        """An epoch ends; the validation before this in the list of callbacks has measured."""
        self._look()

    def _look(self) -> None:
        status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        sizes = {line.split(":")[0]: line.split()[1] for line in status if line.endswith("kB")}
        self.anon = max(self.anon, int(sizes["RssAnon"]) / 1024)
        self.resident = max(self.resident, int(sizes["VmRSS"]) / 1024)


def watched(meter: Meter) -> None:
    """Let the loader tell the meter how long every batch was waited for."""
    batches = AheadLoader.__iter__

    def timed(self: AheadLoader) -> Iterator[Any]:
        inner = batches(self)
        while True:
            began = time.perf_counter()
            batch = next(inner, None)
            meter.wait += time.perf_counter() - began
            if batch is None:
                return
            yield batch

    AheadLoader.__iter__ = timed  # type: ignore[method-assign]


def measured(name: str, size: int, validated: str, given: argparse.Namespace) -> dict[str, Any]:
    """One row, in this process."""
    torch.set_num_threads(1)
    folder, steps = given.out / str(size), given.steps
    stage, data = STAGES[name](folder, max(1, max(given.sizes) // size))
    meter = Meter()
    watched(meter)
    measuring = [validation(name, folder, given.shapes)] if validated == "yes" else []
    trainer = Trainer(
        max_steps=steps,
        max_epochs=-1,
        accelerator="cpu",
        limit_train_batches=steps // VALIDATIONS if measuring else None,
        callbacks=[*measuring, meter],
        inference_mode=False,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(stage, datamodule=data)
    share = meter.wait / (meter.wait + meter.step)
    values = (name, validated, size, steps, round(meter.anon), round(meter.resident))
    taken = (f"{share:.1%}", round(1000 * meter.step / steps))
    return dict(zip(COLUMNS, (*values, *taken), strict=True))


def main() -> None:
    """Every stage at every size, each in a process of its own; prints a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--shapes", type=int, default=40)
    parser.add_argument("--sizes", type=int, nargs="+", default=[40, 4000])
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    parser.add_argument("--validation", nargs="+", choices=("no", "yes"), default=["no"])
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        name, size, validated = given.one.split("/")
        row = measured(name, int(size), validated, given)
        write_json(given.out / f"{name}-{size}-{validated}.json", row)
        return
    console = Console(file=sys.stdout, soft_wrap=True, highlight=False)
    console.print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}", markup=False)
    for size in given.sizes:
        shutil.rmtree(given.out / str(size), ignore_errors=True)
        build(given.out / str(size), given.shapes, size)
        for name, validated in itertools.product(given.stages, given.validation):
            command = [sys.executable, *sys.argv, "--one", f"{name}/{size}/{validated}"]
            subprocess.run(command, check=True)
            row = read_json(given.out / f"{name}-{size}-{validated}.json")
            line = " | ".join(str(row[column]) for column in COLUMNS)
            console.print(f"| {line} |", markup=False)


if __name__ == "__main__":
    main()
