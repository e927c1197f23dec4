"""Cycle consistency of the graph of registrations, and whether it finds better paths.

    python benchmarks/cycles.py RUN/augment RUN/implicit RUN/correspond data/quadrupeds

Of a finished stage correspond=paired. Points of a shape are carried to a neighbour straight away,
and over every third shape that both are registered with; the cycle error of an edge is the median,
over third shapes, of the mean distance, over √area. Then the shared surface is carried along the
tree of least strain (as the stage does), with the edges of largest cycle error pruned, and by
cycle error in place of strain; and synchronised: every image is replaced, some times, by the
median of what all its neighbours' images say. Errors as in images.py, before and after settling.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import joblib
import numpy as np
from images import error, paired_task, settled
from scipy.stats import spearmanr

from gensp.compute import stored_rows
from gensp.data.shapes import ShapeCollection
from gensp.geometry.correspondence import carry
from gensp.geometry.distance import closest_point
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.registration_graph import least_strained_tree
from gensp.stages.pairing import PairedStage
from gensp.tasks.pairing import RegisterPair

SETTLED_FROM = 30.0  # conf/recipe/quick.yaml, correspond.settle_from
PRUNED = (0.1, 0.25, 0.5)  # shares of the edges
ROUNDS = (1, 3)
Pair = tuple[int, int]
Images = dict[int, np.ndarray]


class Graph:
    """The accepted registrations, with their strains; nodes are places in `task.ids`."""

    def __init__(self, task: RegisterPair) -> None:
        self.task, place = task, {id: k for k, id in enumerate(task.ids)}
        self.strains: dict[Pair, float] = {}
        for row in stored_rows(task.folder):
            if row.get("accepted"):
                a, b = str(row["id"]).split("/")
                self.strains[place[a], place[b]] = float(row["strain"] or 0)
        self.near: dict[int, set[int]] = {k: set() for k in place.values()}
        for pair in self.strains:
            self.near[pair[0]].add(pair[1])
            self.near[pair[1]].add(pair[0])

    @cache  # noqa: B019  one graph lives as long as the script
    def bent(self, parent: int, child: int) -> np.ndarray:
        """Vertices of the parent on the child."""
        return self.task.registered(self.task.ids[parent], self.task.ids[child])

    def step(self, points: SurfacePoints, parent: int, child: int) -> SurfacePoints:
        """Carry points across one edge."""
        shapes = self.task.shape(self.task.ids[parent]), self.task.shape(self.task.ids[child])
        return carry(points, shapes[0].mesh.faces, self.bent(parent, child), shapes[1].mesh)

    def on(self, node: int, points: SurfacePoints) -> np.ndarray:
        """Positions."""
        mesh = self.task.shape(self.task.ids[node]).mesh
        return points.on(mesh.vertices, mesh.faces)

    def cycle_error(self, edge: Pair, count: int = 500) -> float:
        """Median over third shapes; NaN for an edge in no triangle."""
        a, b = edge
        mesh = self.task.shape(self.task.ids[a]).mesh
        at = sample_surface(mesh.face_areas, count, np.random.default_rng(0))
        straight = self.on(b, self.step(at, a, b))
        gaps = [
            np.linalg.norm(
                self.on(b, self.step(self.step(at, a, k), k, b)) - straight, axis=1
            ).mean()
            for k in sorted(self.near[a] & self.near[b])
        ]
        scale = np.sqrt(self.task.shape(self.task.ids[b]).mesh.area)
        return float(np.median(gaps) / scale) if gaps else np.nan

    def carried(self, weights: Mapping[Pair, float]) -> tuple[int, Images]:
        """The root of the tree of least weights, and its vertices on every node."""
        tree = least_strained_tree(len(self.task.ids), weights)
        root = int(tree.order[0])
        mesh = self.task.shape(self.task.ids[root]).mesh
        stage = PairedStage(task=self.task, level=4, placement={}, folder=self.task.folder)
        starts = {self.task.ids.index(k): v for k, v in stage.carried(mesh, tree).items()}
        return root, {root: mesh.vertices, **starts}

    def synchronised(self, images: Images, root: int) -> Images:
        """Every image but the root's replaced by the median of what its neighbours say."""
        at = {k: self._located(k, image) for k, image in images.items()}
        found = {root: images[root]}
        for k in images:
            if k != root:
                said = [self.on(k, self.step(at[n], n, k)) for n in self.near[k] if n in at]
                found[k] = self.on(k, self._located(k, np.median(said, axis=0)))
        return found

    def _located(self, node: int, positions: np.ndarray) -> SurfacePoints:
        return closest_point(positions, self.task.shape(self.task.ids[node]).mesh).at


def pruned(graph: Graph, cycles: Mapping[Pair, float], share: float) -> dict[Pair, float]:
    """Strains without the worst edges; what no other edge can replace stays, at the end of all."""
    bound = np.nanquantile(list(cycles.values()), 1 - share)
    return {
        edge: strain + 1e3 * (np.nan_to_num(cycles[edge], nan=0.0) > bound)
        for edge, strain in graph.strains.items()
    }


def _with_strain(graph: Graph, cycles: Mapping[Pair, float]) -> float:
    known = [edge for edge in cycles if np.isfinite(cycles[edge])]
    both = [[values[edge] for edge in known] for values in (graph.strains, cycles)]
    return float(spearmanr(*both).statistic)


def ways(graph: Graph, cycles: Mapping[Pair, float]) -> Iterator[tuple[str, int, Images]]:
    """Name, root and images of every way to carry the shared surface."""
    known = [value for value in cycles.values() if np.isfinite(value)]
    plans = {"least strain": graph.strains}
    plans |= {f"{share:.0%} of edges pruned": pruned(graph, cycles, share) for share in PRUNED}
    plans["least cycle error"] = {e: np.nan_to_num(c, nan=max(known)) for e, c in cycles.items()}
    for name, weights in plans.items():
        root, images = graph.carried(weights)
        yield name, root, images
        for turn in range(1, (name == "least strain") * max(ROUNDS) + 1):
            images = graph.synchronised(images, root)
            if turn in ROUNDS:
                yield f"the same, synchronised {turn} times", root, images


def main() -> None:
    """Print what cycles say, and a row for every way to the images."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("augment", "implicit", "correspond", "collection"):
        parser.add_argument(name, type=Path)
    chosen = parser.parse_args()
    task = paired_task(chosen, SETTLED_FROM)
    collection = ShapeCollection.from_folder(chosen.collection)
    graph = Graph(task)
    edges = list(graph.strains)
    found = joblib.Parallel(-1, "threading")(joblib.delayed(graph.cycle_error)(e) for e in edges)
    cycles = dict(zip(edges, found, strict=True))
    known = [value for value in cycles.values() if np.isfinite(value)]
    sys.stdout.write(
        f"{len(edges)} edges, {len(known)} of them in triangles; cycle error: median "
        f"{np.median(known):.4f}, largest {max(known):.4f}; rank correlation with strain "
        f"{_with_strain(graph, cycles):.2f}\n\n| images | carried | settled |\n|---|--:|--:|\n"
    )
    for name, root, images in ways(graph, cycles):
        mesh = task.shape(task.ids[root]).mesh
        starts = {task.ids[k]: image for k, image in images.items() if k != root}
        ends = (starts, settled(task, mesh, starts, SETTLED_FROM))
        own = {task.ids[root]: mesh.vertices}
        figures = [f"{error(own | end, mesh.faces, collection):.4f}" for end in ends]
        sys.stdout.write(f"| {name} | {' | '.join(figures)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
