"""Stage III-a without a given tree (ours): the inputs find their own by registering pairs."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from jaxtyping import Float

from gensp.compute import Row, run_items, stored_rows
from gensp.data.shapes import SPHERE
from gensp.files import save_npz, write_json
from gensp.geometry.correspondence import carry, correspondence
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.registration_graph import least_strained_tree, reached_nodes
from gensp.geometry.registration_step import corners
from gensp.geometry.shared_sphere import place_for_all
from gensp.geometry.spanning_tree import Tree
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.base import ItemStage, write_table
from gensp.stages.images import image_metrics, lost_rows, mean_of, require_few, write_image
from gensp.tasks.pairing import SHARED, RegisterPair
from gensp.tasks.settling import Settle


class PairedStage(ItemStage):
    """Passes over pairs of inputs; its ending finds the tree and puts all inputs on the sphere.

    The least strained registrations span the tree. The mesh of its root is the shared surface: it
    is registered to every input, from where the tree leads. One placement on the sphere serves
    all: it begins as the root's bijective map and then distorts the mean of all least.

    Writes edges/<a>/<b>.npz and edges.csv, tree.json, settled.csv, shared.npz (the shared surface
    on the sphere and on every input), correspondences/<id>.npz (points, valid) and shapes.csv.

    Parameters
    ----------
    task
        Registers one pair.
    level
        Of the icosphere whose images are handed on.
    placement
        Energy and floor of `geometry.shared_sphere.place_for_all`.
    max_failures
        More input shapes than this without correspondences end the stage.
    workers
        Processes that share the registrations from the root.
    """

    def __init__(
        self,
        *,
        task: RegisterPair,
        level: int,
        placement: Mapping[str, Any] | None,
        max_failures: int = 0,
        workers: Workers | None = None,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(table="edges", max_failures=max_failures, folder=folder)
        self.task, self.level, self.placement = task, level, dict(placement or {})
        self.workers = workers or Workers()

    @classmethod
    def from_runs(
        cls,
        inputs: Mapping[str, Run],
        folder: Path,
        *,
        task: Callable[..., RegisterPair],
        **numbers: Any,
    ) -> Self:
        """With the same task that the items are given to."""
        return cls(task=task(inputs=inputs, folder=folder), folder=folder, **numbers)

    def finish(self) -> dict[str, float]:
        """Span the tree, register from its root, place all on the sphere, write the tables."""
        counts = super().finish()
        tree = self._tree()
        reached = [self.task.ids[k] for k in reached_nodes(tree)]
        self._write_tree(tree, reached)
        images = self._images(tree, reached)
        sphere = self._placed(images)
        rows = self._written(images, sphere, tree)
        lost = [id for id in self.task.ids if id not in reached]
        write_table(self.folder / "shapes.csv", [*rows, *lost_rows(lost)])
        require_few(self.folder, lost, self.max_failures, "raise recipe.correspond.neighbours")
        return {**self._metrics(rows), "lost": len(lost), **counts}

    def _tree(self) -> Tree:
        place = {id: k for k, id in enumerate(self.task.ids)}
        strains = {}
        for row in self.rows:
            if row.get("accepted"):
                a, b = str(row["id"]).split("/")
                strains[place[a], place[b]] = float(row["strain"] or 0)
        return least_strained_tree(len(place), strains)

    def _write_tree(self, tree: Tree, reached: list[str]) -> None:
        """As the other kinds of tree: S_0 first, the root below it."""
        root = int(tree.order[0])
        parent = np.where(tree.parent < 0, -1, tree.parent + 1)
        parent[root] = 0
        content = {
            "ids": [SPHERE, *self.task.ids],
            "parent": np.concatenate([[-1], parent]),
            "weight": np.concatenate([[0.0], tree.weight]),
            "used": np.array([True, *(id in reached for id in self.task.ids)]),
        }
        write_json(self.folder / "tree.json", content)

    def _images(self, tree: Tree, reached: list[str]) -> dict[str, Float[np.ndarray, "n 3"]]:
        """The root's vertices on every input reached."""
        root = self.task.shape(reached[0]).mesh
        starts = self.carried(root, tree)
        if not starts:
            return {reached[0]: root.vertices}
        settle = Settle.prepared(self.task, self.folder / "settled", root, starts)
        for _ in run_items(settle, list(starts), settle.folder, self.workers):
            pass
        write_table(self.folder / "settled.csv", stored_rows(settle.folder))
        return {reached[0]: root.vertices} | {id: settle.image(id) for id in starts}

    def carried(self, root: Mesh, tree: Tree) -> dict[str, Float[np.ndarray, "n 3"]]:
        """The root's vertices carried along the tree, by position on each input but the root."""
        ids = self.task.ids
        at: dict[int, SurfacePoints] = {int(tree.order[0]): corners(root)}
        for node in reached_nodes(tree)[1:]:
            parent = int(tree.parent[node])
            mesh = self.task.shape(ids[parent]).mesh
            bent = self.task.registered(ids[parent], ids[node])
            at[node] = carry(at[parent], mesh.faces, bent, self.task.shape(ids[node]).mesh)
        meshes = {node: self.task.shape(ids[node]).mesh for node in at}
        return {
            ids[node]: points.on(meshes[node].vertices, meshes[node].faces)
            for node, points in list(at.items())[1:]
        }

    def _placed(self, images: Mapping[str, Float[np.ndarray, "n 3"]]) -> SphericalMap:
        """The shared surface on the sphere."""
        root = next(iter(images))
        start = self.task.shape(root).map
        if not self.placement:
            return SphericalMap(start.sphere, start.surface, start.faces, root)
        stack = np.stack(list(images.values()))
        found = place_for_all(stack, start.faces, start.sphere, **self.placement)
        return SphericalMap(found.sphere, start.surface, start.faces, root)

    def _written(
        self, images: Mapping[str, np.ndarray], shared: SphericalMap, tree: Tree
    ) -> list[Row]:
        """Write the icosphere's images; a row for each."""
        ball = icosphere(self.level)
        at = shared.locate(ball.vertices)
        self._keep(images, shared)
        depth = dict(zip(self.task.ids, tree.depth().tolist(), strict=True))
        rows = []
        for id, vertices in images.items():
            mesh = self.task.shape(id).mesh
            met = carry(at, shared.faces, vertices, mesh)
            found = correspondence(met, mesh, ball.faces)
            rows.append(write_image(self.folder, id, found, mesh, depth[id]))
        return rows

    def _keep(self, images: Mapping[str, np.ndarray], shared: SphericalMap) -> None:
        """What the model will know the inputs by: the shared surface on each, and their maps."""
        maps = []
        for id, vertices in images.items():
            own = self.task.shape(id).map
            at = ClosestPointTree(own.mesh).query(vertices).at
            maps.append(own.to_sphere(at))
        save_npz(
            self.folder / SHARED,
            ids=np.array(list(images)),
            sphere=shared.sphere,
            faces=shared.faces,
            images=np.stack(list(images.values())),
            maps=np.stack(maps),
            signals=np.stack([self.task.shape(id).signal for id in images]).astype(np.complex64),
        )

    def _metrics(self, rows: list[Row]) -> dict[str, float]:
        edges = [row for row in self.rows if not row.get("error")]
        return {
            **image_metrics(rows),
            "strain": mean_of(edges, "strain"),
            "seconds_per_edge": mean_of(edges, "seconds"),
            "rejected": sum(not row["accepted"] for row in edges),
        }
