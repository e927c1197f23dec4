"""How far shapes are from what a model of the package knows, and where its limits lie.

    python benchmarks/familiarity.py quadrupeds FOLDER [--split test ...] [--every 4]
    python benchmarks/familiarity.py quadrupeds data/quadrupeds --limits [--write]

A line for every shape: novelty, gap over √area, stretch (`gensp.methods.familiarity`), and which
is above its limit; then how many are. With --limits the shapes are those that the model learnt
from (train and val), every one compared with, and registered from, the shapes of other subjects
alone: people, or kinds of animals. The limits are the largest gap and stretch and a quarter more:
the networks have seen these shapes, and come nearer to them than to others. --write puts them
into the table of models. No map is made: the signals are there before the last step.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

import gensp
from gensp.data.shapes import ShapeCollection
from gensp.files import read_json, write_json
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh, normalize
from gensp.methods.gensp import GenSP
from gensp.models import Atlas
from gensp.pretrained import TABLE, shipped

DIGITS = {"gap": 5, "stretch": 2}  # of the limits, rounded up
MARGIN = 1.25  # over the largest that was found
SPARSE = 16  # of so many vertices one tells on which shape a known one lies


def measured(method: GenSP, mesh: Mesh) -> dict:
    """The signals of a mesh and what is beyond the limits."""
    shape = normalize(mesh)
    code = method.encode(shape)
    return method.familiarity(shape, code, method.fitted(shape, code, method.generate(code)))


def known_subjects(atlas: Atlas, meshes: Mapping[str, Mesh], subjects: Mapping[str, str]) -> list:
    """Whose shape each of the known ones is: of the one that it lies on."""
    trees = {id: ClosestPointTree(normalize(mesh)) for id, mesh in meshes.items()}

    def away(id: str, image: np.ndarray) -> float:
        return float(trees[id].query(image[::SPARSE]).distance.mean())

    images = atlas.images.double().numpy()
    return [subjects[min(trees, key=lambda id: away(id, image))] for image in images]


def left_out(model: str, collection: ShapeCollection) -> Iterator[tuple[str, dict]]:
    """Every shape that was learnt from, by a model that does not know its subject's shapes."""
    method, ids = gensp.load(model), collection.ids("train", "val")
    atlas = method.atlas
    if atlas is None:
        sys.exit(f"error: {model} keeps no shapes")
    meshes = {id: collection.mesh(id) for id in ids}
    subjects = {id: collection.columns(id)["subject"] for id in ids}
    known = known_subjects(atlas, meshes, subjects)
    for subject in dict.fromkeys(subjects.values()):
        method.atlas = atlas.without([k for k, other in enumerate(known) if other == subject])
        own = (id for id in ids if subjects[id] == subject)
        yield from ((id, measured(method, meshes[id])) for id in own)


def line(id: str, found: dict, seconds: float) -> str:
    """One line of the table."""
    signals = f"{found['novelty']:.2f} | {found['gap']:.3%} | {found['stretch']:.3f}"
    return f"| {id} | {signals} | {found['far']} | {seconds:.1f} |\n"


def tabled(shapes: Iterator[tuple[str, dict]]) -> list[dict]:
    """Write the table as it comes; its rows."""
    sys.stdout.write("| shape | novelty | gap | stretch | far by | processor seconds |\n")
    sys.stdout.write("|---|--:|--:|--:|---|--:|\n")
    rows, began = [], time.process_time()
    for id, found in shapes:
        sys.stdout.write(line(id, found, time.process_time() - began))
        sys.stdout.flush()
        rows, began = [*rows, found], time.process_time()
    return rows


def limits(rows: Sequence[dict]) -> dict[str, float]:
    """The largest of each signal, with the margin, rounded up."""
    return {
        name: math.ceil(MARGIN * max(row[name] for row in rows) * 10**digits) / 10**digits
        for name, digits in DIGITS.items()
    }


def write(model: str, found: dict[str, float]) -> None:
    """Put limits into the table of models."""
    table = read_json(TABLE)
    table[model]["limits"] = found
    write_json(TABLE, table)


def main() -> None:
    """Read the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("model", choices=sorted(shipped()))
    parser.add_argument("collection", type=Path, help="folder of the meshes")
    parser.add_argument("--split", nargs="*", default=(), choices=("train", "val", "test"))
    parser.add_argument("--every", type=int, default=1, help="one shape out of so many")
    parser.add_argument("--limits", action="store_true", help="leave out each subject in turn")
    parser.add_argument("--write", action="store_true", help="keep the limits")
    words = parser.parse_args()
    torch.set_num_threads(1)
    collection = ShapeCollection.from_folder(words.collection)
    if words.limits:
        found = limits(tabled(left_out(words.model, collection)))
        sys.stdout.write(f"limits: {found}\n")
        return write(words.model, found) if words.write else None
    method, ids = gensp.load(words.model), collection.ids(*words.split)[:: words.every]
    rows = tabled((id, measured(method, collection.mesh(id))) for id in ids)
    sys.stdout.write(f"far: {sum(bool(row['far']) for row in rows)} of {len(rows)}\n")
    return None


if __name__ == "__main__":
    main()
