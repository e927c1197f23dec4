"""Figures of a model of the package on one split of a collection.

OMP_NUM_THREADS=1 python benchmarks/shipped.py quadrupeds data/quadrupeds --split test

The model is used as it is meant to be. Error: implied correspondence over √area, mean over pairs
with dense ground truth, both directions, without rotation.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from pull import mean_error  # the benchmark beside this one
from rich.console import Console
from rich.progress import track

import gensp
from gensp.data.shapes import ShapeCollection
from gensp.geometry.implied import correspondence_error
from gensp.geometry.spherical_map import SphericalMap
from gensp.pretrained import shipped

COLUMNS = (
    "model",
    "split",
    "shapes",
    "error",
    "mean σ",
    "max σ",
    "bad faces",
    "novelty",
    "gap, %",
    "stretch",
    "far",
    "seconds",
)


def mapped(model: str, collection: ShapeCollection, split: str) -> dict[str, SphericalMap]:
    """The maps of a split, whose `seconds` are processor seconds."""
    method = gensp.load(model)
    found = {}
    for id in track(collection.ids(split), model, console=Console(stderr=True)):
        began = time.process_time()
        found[id] = method(collection.mesh(id))
        found[id].diagnostics["seconds"] = time.process_time() - began
    return found


def span(values: list[float], written: str) -> str:
    """Smallest and largest value."""
    return f"{min(values):{written}} to {max(values):{written}}"


def row(model: str, collection: ShapeCollection, split: str) -> str:
    """One line of a Markdown table."""
    maps = mapped(model, collection, split)
    distortions = [map.distortion() for map in maps.values()]
    said = [map.diagnostics for map in maps.values()]
    cells = (
        model,
        split,
        str(len(maps)),
        f"{mean_error(maps, correspondence_error, collection):.4f}",
        f"{np.mean([d.mean for d in distortions]):.3f}",
        f"{max(d.max for d in distortions):.1f}",
        str(sum(int(map.bad_faces().sum()) for map in maps.values())),
        span([found["novelty"] for found in said], ".1f"),
        span([100 * found["gap"] for found in said], ".3f"),
        span([found["stretch"] for found in said], ".2f"),
        str(sum(bool(found["far"]) for found in said)),
        f"{np.mean([found['seconds'] for found in said]):.1f}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Read the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("model", choices=sorted(shipped()))
    parser.add_argument("collection", type=Path, help="folder of the meshes")
    parser.add_argument("--split", default="test", choices=("train", "val", "test"))
    words = parser.parse_args()
    torch.set_num_threads(1)
    collection = ShapeCollection.from_folder(words.collection)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")  # noqa: T201
    print(row(words.model, collection, words.split))  # noqa: T201


if __name__ == "__main__":
    main()
