"""Stage I on one shape: flow it to the sphere by several schedules, keep the best, sample it."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gensp.compute import Row
from gensp.data.items import item_path
from gensp.data.shapes import ShapeCollection
from gensp.errors import BadMesh, MissingData, Unsupported
from gensp.files import content_hash, save_npz
from gensp.geometry.flow import Flow, StepSchedule, cmcf, flow_score
from gensp.geometry.mesh import Mesh, normalize, simplify
from gensp.geometry.remesh import sound_mesh
from gensp.layout import item_file

LEARNABLE = ("train", "val")  # splits; test is never learnt from


@dataclass(frozen=True)
class AugmentTask:
    """Normalise a shape, flow it, and write its mesh, its flow and samples between.

    Attributes
    ----------
    candidates
        Step-size schedules; the one with the smallest score (Eq. 1) is kept.
    samples
        Shapes taken from the flow.
    flow_vertices, training_vertices
        Size of the mesh that flows, and of the meshes that are handed on.
    score_weight
        η of Eq. 1.
    input_angle, sample_angle
        Inputs and samples with a smaller angle than this, in degrees, are remeshed.
    """

    collection: ShapeCollection
    folder: Path
    candidates: Sequence[StepSchedule]
    samples: int
    flow_vertices: int
    training_vertices: int
    score_weight: float
    max_steps: int
    tolerance: float
    input_angle: float
    sample_angle: float
    seed: int = 0

    def __call__(self, item: str) -> Row:
        """Do all of it for the shape `item`; see the stage for the columns of the row."""
        start = time.perf_counter()
        mesh = self.collection.mesh(item)
        # Folds are what a flow may do to a shape; sharp creases of an input are its own.
        own, remeshed = sound_mesh(
            mesh, self.training_vertices, smallest_angle=self.input_angle, unfolded=False
        )
        own = normalize(own)
        save_npz(item_path(self.folder, item), vertices=own.vertices, faces=own.faces, t=0.0)
        row: Row = {"id": item, "split": self.collection.shape(item).split}
        row |= {"input_remeshed": remeshed, **self._augment(item, mesh)}
        return row | {"seconds": round(time.perf_counter() - start, 3)}

    @property
    def files_each(self) -> int:
        """Meshes of one shape: its own and its samples, all in one folder."""
        return 1 + self.samples

    def _augment(self, item: str, mesh: Mesh) -> Row:
        try:
            rest = normalize(simplify(mesh, self.flow_vertices))
            flow, step, score = self._best_flow(rest)
        except BadMesh as error:
            return {"score": None, "reason": str(error), "kept": 0}
        self._save_flow(item, flow, step, score)
        last_sound = np.flatnonzero(flow.sound)[-1]
        return {
            "step": str(step),
            "score": score,
            "steps": len(flow.times) - 1,
            "converged": flow.converged,
            "reason": flow.reason,
            "sphere_error": float(flow.sphere_error[-1]),
            "arc_length": float(flow.arc_length[-1]),
            # Beyond this share of the way the flow's own triangles have lost their area.
            "geometry_only_from": float(flow.arc_length[last_sound] / flow.arc_length[-1]),
            **self._sample(item, flow),
        }

    def _best_flow(self, rest: Mesh) -> tuple[Flow, StepSchedule, float]:
        """The candidate with the smallest score m* (paper §4.1)."""
        found = []
        for step in self.candidates:
            flow = cmcf(rest, step=step, max_steps=self.max_steps, tolerance=self.tolerance)
            found.append((flow, step, flow_score(flow, rest, weight=self.score_weight)))
        return min(found, key=lambda candidate: candidate[2])

    def _save_flow(self, item: str, flow: Flow, step: StepSchedule, score: float) -> None:
        save_npz(
            item_file(self.folder, "flows", item),
            vertices=flow.vertices.astype(np.float32),
            faces=flow.faces,
            times=flow.times,
            arc_length=flow.arc_length,
            sphere_error=flow.sphere_error,
            sound=flow.sound,
            step=np.array(str(step)),
            score=score,
        )

    def _sample(self, item: str, flow: Flow) -> Row:
        """Write the samples as meshes "<item>@<k>"; columns on what became of them."""
        fractions = self._fractions(item)
        kept, remeshed, dropped = 0, 0, []
        for k, t in enumerate(fractions):
            shape = Mesh(flow.at(np.array([t]))[0], flow.faces, f"{item}@{k}")
            try:
                mesh, anew = sound_mesh(
                    shape, self.training_vertices, smallest_angle=self.sample_angle
                )
            except BadMesh as error:
                dropped.append(str(error))
                continue
            mesh = normalize(mesh)
            path = item_path(self.folder, shape.name)
            save_npz(path, vertices=mesh.vertices, faces=mesh.faces, t=t)
            kept, remeshed = kept + 1, remeshed + anew
        return {
            "kept": kept,
            "geometry_only": remeshed,
            "dropped": len(dropped),
            "dropped_because": "; ".join(dropped),
        }

    def _fractions(self, item: str) -> Float[np.ndarray, " k"]:
        """Fractions t of the arc length, one uniform in each of `samples` equal parts."""
        # Seeded by the name, so a shape's samples do not depend on the rest of the collection.
        rng = np.random.default_rng(int(content_hash(item, self.seed), 16))
        return (np.arange(self.samples) + rng.random(self.samples)) / max(self.samples, 1)


def augment_task(
    *,
    inputs: Mapping[str, Any],
    folder: Path,
    collection: ShapeCollection,
    candidates: Sequence[Mapping[str, float]],
    **settings: Any,
) -> AugmentTask:
    """The task as the configuration gives it: schedules as first, growth, largest."""
    schedules = tuple(StepSchedule(**candidate) for candidate in candidates)
    if not schedules:
        raise ValueError("recipe.augment.candidates is empty; at least one schedule is required")
    return AugmentTask(collection, Path(folder), schedules, **settings)


def augment_items(
    *,
    inputs: Mapping[str, Any],
    folder: Path,
    collection: ShapeCollection,
    learn_from: Sequence[str] = LEARNABLE,
) -> list[str]:
    """Ids of the shapes that are learnt from: never those held out for testing.

    Raises
    ------
    Unsupported
        `learn_from` names other splits than train and val, or none.
    MissingData
        They hold no shape.
    """
    if not learn_from or not set(learn_from) <= set(LEARNABLE):
        raise Unsupported(
            f"recipe.augment.learn_from=[{','.join(map(str, learn_from))}]: one or both of "
            f"{', '.join(LEARNABLE)} are required; the split test is never learnt from"
        )
    ids = collection.ids(*learn_from)
    if not ids:
        raise MissingData(
            f"{collection.name}: no shape belongs to {' or '.join(learn_from)}; at least one is "
            "required to learn from; set recipe.augment.learn_from or the splits of the manifest"
        )
    return ids
