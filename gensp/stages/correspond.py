"""Stage III-a (paper §4.3): correspondences between the sphere and every training shape."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from gensp.compute import Row
from gensp.files import load_npz, write_json
from gensp.geometry.correspondence import Correspondence, propagate
from gensp.geometry.spanning_tree import Tree
from gensp.geometry.sphere import icosphere
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.base import ItemStage, write_table
from gensp.stages.images import image_metrics, lost_rows, mean_of, require_few, write_image
from gensp.tasks.again import Rounds
from gensp.tasks.correspond import RegisterEdge, edge_path, is_input
from gensp.tasks.joining import (
    Trial,
    alternative_path,
    alternative_row,
    joined_parents,
    register_elsewhere,
)
from gensp.terminal import warn


class CorrespondStage(ItemStage):
    """Passes over the edges of the tree; its ending carries the icosphere outward along them.

    Writes edges/<child>.npz and edges.csv, tree.json, correspondences/<id>.npz (points, valid)
    of every shape reached, and shapes.csv. A shape whose edge failed every retry is joined to
    another node that was reached (alternatives/<parent>/edges/<child>.npz); where that fails too,
    it is reported and left out.

    Parameters
    ----------
    task
        Registers one edge; knows the tree.
    level
        Of the icosphere that is carried.
    alternatives
        How many other parents a failed edge may try; none in a star.
    max_failures
        More input shapes than this without correspondences end the stage.
    workers
        Processes that share the registrations to other parents.
    rounds
        Makes the images of the inputs agree, once they are carried.
    """

    def __init__(
        self,
        *,
        task: RegisterEdge,
        level: int,
        alternatives: int = 3,
        max_failures: int = 0,
        workers: Workers | None = None,
        rounds: Rounds | None = None,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(table="edges", max_failures=max_failures, folder=folder)
        self.task = task
        self.level = level
        self.rounds = rounds or Rounds()
        self._kept = 0
        self.alternatives = 0 if task.kind == "star" else alternatives
        self.workers = workers or Workers()
        self.parents: dict[str, str] = {}

    @classmethod
    def from_runs(
        cls,
        inputs: Mapping[str, Run],
        folder: Path,
        *,
        task: Callable[..., RegisterEdge],
        **numbers: Any,
    ) -> Self:
        """With the same task that the items are given to."""
        return cls(task=task(inputs=inputs, folder=folder), folder=folder, **numbers)

    def finish(self) -> dict[str, float]:
        """Join what failed elsewhere, carry the icosphere outward, write the tables."""
        self.parents = self._parents_reached()
        counts = super().finish()
        tree, reached = self._final_tree(self.parents)
        self._write_tree(tree, reached)
        images = self._agreed(dict(self._carried(tree, reached)))
        rows = [
            write_image(self.folder, id, found, self.task.mesh(id), self._depth[id])
            for id, found in images.items()
        ]
        lost = [id for id in self.task.shapes.ids if is_input(id) and id not in self.parents]
        rows += lost_rows(lost)
        write_table(self.folder / "shapes.csv", rows)
        require_few(self.folder, lost, self.max_failures, "add recipe.correspond.retries")
        metrics = self._metrics([row for row in rows if not row.get("error")])
        return {**metrics, "lost": len(lost), **counts}

    @property
    def rows(self) -> list[Row]:
        """The rows of the edges in use: where a shape was joined elsewhere, of that edge."""
        return [self._row_in_use(row) for row in super().rows]

    def _row_in_use(self, row: Row) -> Row:
        child = str(row["id"])
        if not self._elsewhere(child):
            return row
        other = alternative_row(self.folder, child, self.parents[child])
        return {**(other or row), "joined_elsewhere": True}

    def _elsewhere(self, child: str) -> bool:
        return self.parents.get(child) not in (None, self.task.shapes.edges[child])

    def _parents_reached(self) -> dict[str, str]:
        """Child → parent of accepted edges that hang together with the root, in order."""

        def register(trials: list[Trial]) -> Mapping[Trial, bool]:
            return register_elsewhere(self.task, trials, self.workers)

        shapes = self.task.shapes
        accepted = [child for child in shapes.edges if self._accepted(child)]
        return joined_parents(shapes, accepted, self.alternatives, register)

    def _accepted(self, child: str) -> bool:
        path = edge_path(self.folder, child)
        return path.is_file() and bool(load_npz(path)["accepted"])

    def _registered(self, child: str) -> np.ndarray:
        """Vertices of the parent's mesh on the child."""
        elsewhere = self._elsewhere(child)
        path = (
            alternative_path(self.folder, child, self.parents[child])
            if elsewhere
            else edge_path(self.folder, child)
        )
        return load_npz(path)["vertices"]

    def _final_tree(self, parents: Mapping[str, str]) -> tuple[Tree, np.ndarray]:
        """The tree with its changed edges, and the nodes that the icosphere reaches."""
        shapes = self.task.shapes
        index = {id: k for k, id in enumerate(shapes.ids)}
        parent, weight = shapes.tree.parent.copy(), shapes.tree.weight.copy()
        reached = np.zeros(len(parent), dtype=bool)
        reached[shapes.tree.order[0]] = True
        for child, other in parents.items():
            k, above = index[child], index[other]
            parent[k], reached[k] = above, True
            weight[k] = np.linalg.norm(shapes.codes[k] - shapes.codes[above])
        # Another parent always came earlier in this order, so it stays parents first.
        return replace(shapes.tree, parent=parent, weight=weight), reached

    def _write_tree(self, tree: Tree, reached: np.ndarray) -> None:
        content = {
            "ids": list(self.task.shapes.ids),
            "parent": tree.parent,
            "weight": tree.weight,
            "used": reached,
        }
        write_json(self.folder / "tree.json", content)

    def _carried(self, tree: Tree, reached: np.ndarray) -> Iterator[tuple[str, Correspondence]]:
        ids = self.task.shapes.ids
        carried = propagate(
            tree,
            reached,
            mesh=lambda k: self.task.mesh(ids[k]),
            registered=lambda k: self._registered(ids[k]),
            sphere=icosphere(self.level),
        )
        self._depth = dict(zip(ids, tree.depth().tolist(), strict=True))
        yield from ((ids[k], found) for k, found in carried if tree.parent[k] >= 0)

    def _agreed(self, carried: dict[str, Correspondence]) -> dict[str, Correspondence]:
        """The images, those of the inputs after the further rounds; writes rounds.csv."""
        inputs = {id: found for id, found in carried.items() if is_input(id)}
        if self.rounds.count == 0 or len(inputs) < 2:
            return carried
        agreed, rows = self.rounds(self.task, self.folder, inputs)
        write_table(self.folder / "rounds.csv", rows)
        self._kept = sum(bool(row.get("kept")) for row in rows)
        broken = sorted({str(row["id"]) for row in rows if row.get("error")})
        if broken:
            warn(
                f"{', '.join(broken)}: not registered again, the images carried along the tree "
                f"are kept; see {self.folder / 'rounds.csv'}"
            )
        return carried | agreed

    def _metrics(self, rows: list[Row]) -> dict[str, float]:
        edges = [row for row in self.rows if not row.get("error")]
        return {
            **image_metrics(rows),
            "residual": mean_of(edges, "residual"),
            "seconds_per_edge": mean_of(edges, "seconds"),
            "retried": sum(int(row["attempts"] or 0) > 1 for row in edges),
            "joined_elsewhere": sum(bool(row.get("joined_elsewhere")) for row in edges),
            "rejected": sum(not row["accepted"] for row in edges),
            "registered_again": self._kept,
        }
