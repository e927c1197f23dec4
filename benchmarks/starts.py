"""How registrations of one body in two poses end, by where they start and how stiff they begin.

    python benchmarks/starts.py data/quadrupeds --pairs 12

Pairs of shapes of one template, drawn by a seed; errors against dense ground truth, over √area.
"""

import argparse
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from gensp.data.ground_truth import common_points
from gensp.data.shapes import ShapeCollection
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.guided_registration import PATIENT, MappedShape, guides, posed
from gensp.geometry.mesh import normalize, simplify
from gensp.geometry.registration import Registration, RegistrationSettings, approached
from gensp.geometry.registration_step import BendingSystem, scale_of
from gensp.methods.hierarchical import dirichlet

SCHEDULES = {"default": RegistrationSettings().schedule, "patient": PATIENT}


class Study:
    """Shapes of a collection, simplified, each with its own map."""

    def __init__(self, root: Path, vertices: int) -> None:
        self.collection = ShapeCollection.from_folder(root)
        self.vertices = vertices
        self.shape = cache(self._shape)

    def _shape(self, id: str) -> MappedShape:
        return MappedShape(
            dirichlet()(simplify(normalize(self.collection.mesh(id)), self.vertices))
        )

    def pairs(self, count: int, seed: int) -> list[tuple[str, str]]:
        """Ordered pairs of one template, drawn without repetition."""
        ids = self.collection.ids()
        template = {id: self.collection.shape(id).template for id in ids}
        alike = [(a, b) for a in ids for b in ids if a != b and template[a] == template[b]]
        drawn = np.random.default_rng(seed).permutation(len(alike))[:count]
        return [alike[k] for k in sorted(drawn)]

    def error(self, a: str, b: str, image: np.ndarray) -> float:
        """Mean error of the source's vertices at `image`, at points with ground truth."""
        there, here = (self.collection.ground_truth(id) for id in (b, a))
        assert here is not None
        assert there is not None
        rows, others = common_points(here, there)
        meshes = [normalize(self.collection.mesh(id)) for id in (a, b)]
        start = here.at.take(rows).on(meshes[0].vertices, meshes[0].faces)
        true = there.at.take(others).on(meshes[1].vertices, meshes[1].faces)
        source = self.shape(a).mesh
        at = ClosestPointTree(source).query(start).at
        gap = np.linalg.norm(at.on(image, source.faces) - true, axis=1)
        return float(gap.mean() / np.sqrt(meshes[1].area))

    def ends(self, a: str, b: str) -> Iterator[tuple[str, float, float]]:
        """(start and schedule, error, strain) of every way to register a to b."""
        source, target = self.shape(a), self.shape(b)
        led = guides(source, target, 1)[0]
        yield "guide itself", self.error(a, b, led), np.nan
        for name, schedule in SCHEDULES.items():
            settings = RegistrationSettings(schedule=schedule)
            bending = BendingSystem(source.mesh, settings)
            pose = posed(bending, led, settings, scale_of(target.mesh))
            if name == "default":
                yield "pose by the guide", self.error(a, b, pose), bending.strain(pose)
            for start, vertices in (("source", source.mesh.vertices), ("pose", pose)):
                found: Registration = approached(
                    source.mesh, [target.mesh], settings, bending, vertices
                )
                yield f"{start}, {name}", self.error(a, b, found.vertices), found.strain


def main() -> None:
    """Print the mean, median and largest error of every way, and of the least strained."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("collection", type=Path)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--vertices", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    study = Study(chosen.collection, chosen.vertices)
    errors: dict[str, list[float]] = {}
    for a, b in study.pairs(chosen.pairs, chosen.seed):
        ends = list(study.ends(a, b))
        for name, error, _ in ends:
            errors.setdefault(name, []).append(error)
        registered = [end for end in ends if "," in end[0]]
        errors.setdefault("least strained of all", []).append(
            min(registered, key=lambda end: end[2])[1]
        )
    lines = ["| start, schedule | mean error | median | largest |", "|---|--:|--:|--:|"]
    for name, found in errors.items():
        mean, median, largest = np.mean(found), np.median(found), np.max(found)
        lines.append(f"| {name} | {mean:.4f} | {median:.4f} | {largest:.4f} |")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
