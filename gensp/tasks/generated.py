"""How the surfaces that a generator makes of a few known shapes fare, before any map is made."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float

from gensp.data.ground_truth import GroundTruth, common_points
from gensp.data.shapes import ShapeCollection
from gensp.geometry.consistency import (
    GeneratedShape,
    HausdorffIndex,
    coverage,
    generated_consistency,
)
from gensp.geometry.correspondence import faces_at_fault
from gensp.geometry.distortion import isometric_distortion, singular_values
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere


@dataclass(frozen=True)
class KnownPair:
    """The rows of common ground truth of two shapes, and their Hausdorff distance."""

    first: str
    second: str
    rows: np.ndarray
    others: np.ndarray
    hausdorff: float


class KnownShapes:
    """A few shapes of a collection at area 4π, with what their comparisons share.

    Parameters
    ----------
    level
        Of the icosphere whose images are measured.
    points
        At most so many points of the common ground truth are compared.
    """

    def __init__(
        self, collection: ShapeCollection, ids: list[str], *, level: int = 4, points: int = 512
    ) -> None:
        self.points = points
        self.meshes = {id: normalize(collection.mesh(id)) for id in ids}
        self.truths = {id: collection.ground_truth(id) for id in ids}
        self.ball = icosphere(level)

    @cached_property
    def pairs(self) -> list[KnownPair]:
        """The pairs that dense ground truth joins."""
        index = {id: HausdorffIndex(mesh) for id, mesh in self.meshes.items()}
        found = []
        for a, b in combinations(self.meshes, 2):
            rows, others = _common(self.truths[a], self.truths[b])
            some = np.linspace(0, len(rows) - 1, min(len(rows), self.points)).astype(int)
            rows, others = rows[some], others[some]
            apart = index[a].distance(index[b])
            if len(rows) and apart > 0:  # c is a quotient by it
                found.append(KnownPair(a, b, rows, others, apart))
        return found

    def figures(self, images: Mapping[str, Float[np.ndarray, "n 3"]]) -> dict[str, float]:
        """Means over the shapes and pairs.

        Parameters
        ----------
        images
            For every shape the image of the icosphere's vertices, at area 4π of the shape.

        Returns
        -------
        dict
            `sigma`: mean σ of the triangles that are neither folded nor collapsed; `bad_faces`:
            percentage of those that are; `coverage`, as the evaluation has it; `c`, where two
            shapes have ground truth in common.
        """
        made = {
            id: GeneratedShape(
                mesh, Mesh(np.asarray(images[id], dtype=float), self.ball.faces, id)
            )
            for id, mesh in self.meshes.items()
        }
        rows = [self._row(shape) for shape in made.values()]
        means = {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}
        return means | self._consistency(made)

    def _row(self, shape: GeneratedShape) -> dict[str, float]:
        image = shape.image
        at = shape.on_mesh.query(image.vertices).at
        bad = faces_at_fault(image, at, shape.mesh)
        values = singular_values(self.ball.vertices, image.vertices, image.faces)
        sigma = isometric_distortion(values)[~bad]
        return {
            "sigma": float(sigma.mean()) if len(sigma) else np.nan,
            "bad_faces": 100 * float(bad.mean()),
            "coverage": coverage(shape.mesh, image).mean,
        }

    def _consistency(self, made: Mapping[str, GeneratedShape]) -> dict[str, float]:
        found = []
        for pair in self.pairs:
            one, other = self.truths[pair.first], self.truths[pair.second]
            assert one is not None
            assert other is not None
            points = one.take(pair.rows).at, other.take(pair.others).at
            shapes = made[pair.first], made[pair.second]
            found.append(generated_consistency(*shapes, *points, pair.hausdorff))
        return {"c": float(np.mean(found))} if found else {}


def _common(
    first: GroundTruth | None, second: GroundTruth | None
) -> tuple[np.ndarray, np.ndarray]:
    if first is None or second is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return common_points(first, second)
