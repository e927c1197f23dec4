"""Work on one shape of the evaluation: its own row, and its share of the pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gensp.compute import Row, finished_row
from gensp.data.ground_truth import GroundTruth
from gensp.data.shapes import ShapeCollection
from gensp.errors import MissingData
from gensp.files import load_npz, write_json
from gensp.geometry.consistency import coverage
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere_of
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.layout import item_file
from gensp.runs import Run
from gensp.tasks.pairs import EvaluatedMap, Record, frame_record, pair_records

# With whom a shape without ground truth is compared unless `partners` says: c is of the nearest.
PARTNERS_IN_FRAME = 12


@dataclass(frozen=True)
class Evaluate:
    """Evaluate the map of one shape.

    Attributes
    ----------
    parameterize, folder
        Where the maps are, and where rows and pairs are written.
    level
        Icosphere level of the remeshed surface whose coverage is measured.
    samples
        Random points that stand for the sphere, and for the surface, in c.
    partners
        About so many other shapes each shape is compared with; none: with all, but with
        `PARTNERS_IN_FRAME` where the collection has no ground truth at all.
    """

    parameterize: Path
    folder: Path
    collection: ShapeCollection
    level: int = 5
    samples: int = 10_000
    partners: int | None = None

    def __call__(self, id: str) -> Row:
        """Write `pairs/<id>.json` and give the shape's row."""
        row = self._row(id)
        pairs = [record for other in self._partners(id) for record in self._pair(id, other)]
        write_json(pairs_path(self.folder, id), pairs)
        return row

    def _partners(self, id: str) -> list[str]:
        """The shapes whose pair with this one is measured here: half of all, each pair once."""
        circle = _circle(self.collection)
        place, partners = circle.places[id], self.partners
        if partners is None and not self.collection.has_truth:
            partners = PARTNERS_IN_FRAME
        return [
            circle.ids[index]
            for index in circle.near(place, partners)
            if (index + place) % 2 == (index > place)
            and map_path(self.parameterize, circle.ids[index]).is_file()
        ]

    def _pair(self, id: str, other: str) -> list[Record]:
        names = {"first": id, "second": other, "group": self._group(id, other)}
        maps = self._map(id), self._map(other)
        records = pair_records(*maps) if self.collection.has_truth else [frame_record(*maps)]
        return [names | record for record in records]

    def _group(self, id: str, other: str) -> str:
        split = self.collection.shape(id).split
        return split if split == self.collection.shape(other).split else "mixed"

    def _map(self, id: str) -> EvaluatedMap:
        written = map_path(self.parameterize, id).stat().st_mtime_ns
        return _evaluated(self.parameterize, id, written, self.collection, self.samples)

    def _row(self, id: str) -> Row:
        evaluated = self._map(id)
        map, shape = evaluated.map, self.collection.shape(id)
        bad, distortion = int(map.bad_faces().sum()), map.distortion()
        made = finished_row(self.parameterize, id) or {}
        return {
            "id": id,
            "split": shape.split,
            "template": shape.template,
            "vertices": len(map.surface),
            "faces": len(map.faces),
            "sigma_mean": distortion.mean,
            "sigma_max": distortion.max,
            "sigma_area": distortion.area_weighted_mean,
            "conformal_mean": distortion.conformal_mean,
            "conformal_max": distortion.conformal_max,
            "bad_faces": bad,
            "bad_faces_percent": 100 * bad / len(map.faces),
            "degree": map.degree(),
            **_coverage("coverage", map.mesh, map.icosphere_remesh(self.level)),
            **self._prediction(id, map.mesh),
            "seconds": made.get("seconds"),
            "processor_seconds": made.get("processor_seconds"),
        }

    def _prediction(self, id: str, mesh: Mesh) -> Row:
        """Coverage of the surface that the generator made of the icosphere, if there is one."""
        surface = predicted_surface(self.parameterize, id, "generated")
        return {} if surface is None else _coverage("prediction_coverage", mesh, surface)


def _coverage(name: str, mesh: Mesh, surface: Mesh) -> Row:
    found = coverage(mesh, surface)
    return {f"{name}_mean": found.mean, f"{name}_max": found.max}


def map_path(parameterize: Path, id: str) -> Path:
    """Where the map of a shape is kept."""
    return item_file(parameterize, "maps", id)


def pairs_path(folder: Path, id: str) -> Path:
    """Where the pairs that a shape answers for are kept."""
    return item_file(folder, "pairs", id, ".json")


def prediction(parameterize: Path, id: str) -> dict[str, np.ndarray]:
    """The arrays that a map started from; nothing where its method predicts nothing."""
    path = item_file(parameterize, "predictions", id)
    return load_npz(path) if path.is_file() else {}


def predicted_surface(parameterize: Path, id: str, kind: str) -> Mesh | None:
    """A prediction's image of the icosphere, or of another triangulated sphere, or none.

    At area 4π of the shape.

    Parameters
    ----------
    kind
        "generated", or "fitted": what the map was read off.
    """
    arrays = prediction(parameterize, id)
    if kind not in arrays:
        return None
    points = arrays[kind].astype(float)
    faces = arrays.get(f"{kind}_faces")
    return Mesh(points, icosphere_of(len(points)).faces if faces is None else faces, id)


def mapped_ids(collection: ShapeCollection, parameterize: Path) -> list[str]:
    """Shapes of a collection that have a map, in its order."""
    return [id for id in collection.ids() if map_path(parameterize, id).is_file()]


class Circle:
    """All shapes on a circle in random order, the same for every method.

    Each is compared with those next to it: so all take part in equally many pairs.

    Attributes
    ----------
    ids, places
        The shapes, and where each stands in that list.
    """

    def __init__(self, ids: Sequence[str]) -> None:
        self.ids, self.places = list(ids), {id: place for place, id in enumerate(ids)}
        self._order = np.random.default_rng(0).permutation(len(ids))
        self._turn = np.argsort(self._order)

    def near(self, place: int, partners: int | None) -> list[int]:
        """Places, ascending, of about so many other shapes; of all for None."""
        count = len(self.ids)
        if partners is None or partners >= count - 1:
            return [other for other in range(count) if other != place]
        reach = (partners + 1) // 2
        steps = np.arange(-reach, reach + 1)
        near = np.unique(self._order[(self._turn[place] + steps) % count])
        return [int(other) for other in near if other != place]


@lru_cache(maxsize=1)
def _circle(collection: ShapeCollection) -> Circle:
    return Circle(collection.ids())


# A worker meets every map in many pairs.
@lru_cache(maxsize=128)
def _evaluated(
    parameterize: Path, id: str, written: int, collection: ShapeCollection, samples: int
) -> EvaluatedMap:
    path = map_path(parameterize, id)
    map = load_map(path)
    truth = collection.ground_truth(map.name)
    keypoints = collection.keypoints(map.name)
    for known in (truth, keypoints):
        _require_fit(map, known, path)
    image = predicted_surface(parameterize, id, "fitted")
    symmetries = collection.symmetries(map.name)
    return EvaluatedMap(map, truth, keypoints, samples=samples, image=image, symmetries=symmetries)


def _require_fit(map: SphericalMap, truth: GroundTruth | None, path: Path) -> None:
    if truth is not None and len(truth.ids) and truth.at.faces.max() >= len(map.faces):
        raise MissingData(
            f"{path}: has {len(map.faces)} faces, but its ground truth names face "
            f"{truth.at.faces.max()}; ground truth of this very mesh is required; correct or "
            f"remove the entry of {map.name}"
        )


def evaluate_task(
    inputs: Mapping[str, Run], folder: Path, *, collection: ShapeCollection, **settings: Any
) -> Evaluate:
    """The work on one shape, for the items' DataModule."""
    return Evaluate(inputs["parameterize"].folder, folder, collection, **settings)


def evaluate_items(
    inputs: Mapping[str, Run], folder: Path, *, collection: ShapeCollection
) -> list[str]:
    """Shapes that have a map.

    Raises
    ------
    MissingData
        None has.
    """
    parameterize = inputs["parameterize"].folder
    ids = mapped_ids(collection, parameterize)
    if not ids:
        raise MissingData(
            f"{parameterize / 'maps'}: holds no map of collection {collection.name}; at least one "
            "is required; run stage=parameterize again, with the same shapes"
        )
    return ids
