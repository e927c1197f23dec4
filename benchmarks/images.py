"""How well the shared surface lies on the training shapes, before any network learns it.

    python benchmarks/images.py RUN/augment RUN/implicit RUN/correspond data/quadrupeds

Of a finished stage correspond=paired. Error of its images against dense ground truth, over √area,
mean over ordered pairs of one template: carried along trees of several kinds, and settled from
there at several first stiffnesses.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import joblib
import numpy as np
import scipy.sparse.csgraph as graph

from gensp.compute import stored_rows
from gensp.data.ground_truth import common_points
from gensp.data.shapes import ShapeCollection
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.guided_registration import PATIENT
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.registration import Acceptance, RegistrationSettings, register
from gensp.geometry.registration_graph import least_strained_tree
from gensp.geometry.spanning_tree import Tree
from gensp.stages.pairing import PairedStage
from gensp.tasks.pairing import RegisterPair

STIFFEST = (300.0, 30.0, 3.0)


def trees(task: RegisterPair) -> dict[str, Tree]:
    """Minimum spanning tree, and the tree of shortest paths, by strain."""
    place = {id: k for k, id in enumerate(task.ids)}
    strains = {}
    for row in stored_rows(task.folder):
        if row.get("accepted"):
            a, b = str(row["id"]).split("/")
            strains[place[a], place[b]] = float(row["strain"] or 0)
    minimum = least_strained_tree(len(place), strains)
    cost = np.zeros((len(place), len(place)))
    for (i, j), strain in strains.items():
        cost[i, j] = cost[j, i] = strain
    length, parent = graph.dijkstra(
        cost, directed=False, indices=int(minimum.order[0]), return_predecessors=True
    )
    order = np.argsort(length, kind="stable").astype(np.int64)
    shortest = Tree(np.where(parent < 0, -1, parent).astype(np.int64), order, minimum.weight)
    return {"minimum": minimum, "shortest": shortest}


def error(
    images: Mapping[str, np.ndarray], faces: np.ndarray, collection: ShapeCollection
) -> float:
    """Mean error of the correspondences that the images imply."""
    meshes = {id: normalize(collection.mesh(id)) for id in images}
    known = {id: collection.ground_truth(id) for id in images}
    truths = {id: truth for id, truth in known.items() if truth is not None}
    places, found = {}, {}
    for id, truth in truths.items():
        places[id] = truth.at.on(meshes[id].vertices, meshes[id].faces)
        found[id] = ClosestPointTree(Mesh(images[id], faces)).query(places[id]).at
    errors = []
    for a in truths:
        for b in truths:
            rows, others = common_points(truths[a], truths[b])
            if a != b and len(rows):
                carried = found[a].take(rows).on(images[b], faces)
                gap = np.linalg.norm(carried - places[b][others], axis=1).mean()
                errors.append(gap / np.sqrt(meshes[b].area))
    return float(np.mean(errors))


def settled(
    task: RegisterPair, root: Mesh, starts: Mapping[str, np.ndarray], stiffest: float
) -> dict[str, np.ndarray]:
    """The root registered to every input from where a tree led."""
    one = partial(register, root, settings=replace(task, settle_from=stiffest).softened)
    calls = (
        joblib.delayed(one)([task.shape(id).mesh], start=start) for id, start in starts.items()
    )
    registered = joblib.Parallel(n_jobs=-1)(calls)
    return {id: found.vertices for id, found in zip(starts, registered, strict=True)}


def paired_task(chosen: argparse.Namespace, settle_from: float) -> RegisterPair:
    """The registrations that a finished stage correspond=paired has kept."""
    return RegisterPair(
        augment=chosen.augment,
        implicit=chosen.implicit,
        folder=chosen.correspond,
        neighbours=0,
        guides=0,
        settings=RegistrationSettings(schedule=PATIENT),
        acceptance=Acceptance(),
        settle_from=settle_from,
    )


def main() -> None:
    """Print a row for every tree and first stiffness."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("augment", "implicit", "correspond", "collection"):
        parser.add_argument(name, type=Path)
    chosen = parser.parse_args()
    task = paired_task(chosen, STIFFEST[0])
    stage = PairedStage(task=task, level=4, folder=chosen.correspond)
    collection = ShapeCollection.from_folder(chosen.collection)
    sys.stdout.write("| tree | depth | then | error |\n|---|--:|---|--:|\n")
    for name, tree in trees(task).items():
        root = task.ids[int(tree.order[0])]
        mesh = task.shape(root).mesh
        starts = stage.carried(mesh, tree)
        ends = {"carried": starts} | {
            f"settled from stiffness {stiffest:g}": settled(task, mesh, starts, stiffest)
            for stiffest in STIFFEST
        }
        for then, images in ends.items():
            measured = error({root: mesh.vertices, **images}, mesh.faces, collection)
            depth = f"{tree.depth().mean():.1f}"
            sys.stdout.write(f"| {name} | {depth} | {then} | {measured:.4f} |\n")


if __name__ == "__main__":
    main()
