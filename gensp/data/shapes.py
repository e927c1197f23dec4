"""Collections of genus-0 meshes: which shapes, which split, which ground truth.

A collection is a folder. A `manifest.csv` in it names the meshes, their splits and their
correspondence files; without one, every ply, obj, off and stl file is a shape.
"""

import csv
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gensp.data.blobs import BlobFamily, generate_blobs
from gensp.data.ground_truth import GroundTruth, load_ground_truth, load_keypoints
from gensp.data.validation import checked
from gensp.errors import MissingData, Unsupported
from gensp.files import content_hash
from gensp.geometry.mesh import FORMATS, Mesh, load_mesh

SPLITS = ("train", "val", "test")
SPHERE = "sphere"


@dataclass(frozen=True)
class Shape:
    """One mesh file of a collection; shapes of one template share ground-truth ids."""

    id: str
    path: Path
    split: str = "train"
    template: str | None = None
    correspondence: Path | None = None


class ShapeCollection:
    """Checked shapes with their splits and ground truth; see `from_folder`.

    Attributes
    ----------
    skipped
        (id, reason) of the meshes that were left out under on_bad=skip.
    up
        Axis that points up in pictures: x, y or z.
    """

    def __init__(
        self,
        name: str,
        shapes: Sequence[Shape],
        *,
        keypoints: Path | None = None,
        on_bad: str = "error",
        max_faces: int | None = None,
        up: str = "y",
        cache: Path | str | None = None,
    ) -> None:
        self.name = name
        self.up = up
        _require_names(shapes)
        sound, self.skipped = checked(shapes, on_bad=on_bad, max_faces=max_faces, cache=cache)
        self._shapes = {shape.id: shape for shape in sound}
        self._keypoint_file = keypoints

    @classmethod
    def from_folder(
        cls,
        root: Path | str,
        *,
        name: str | None = None,
        on_bad: str = "error",
        max_faces: int | None = None,
        test_fraction: float = 0.0,
        split_seed: int = 0,
        up: str = "y",
        cache: Path | str | None = None,
    ) -> "ShapeCollection":
        """Read a folder of meshes, with or without `manifest.csv`, `corr/` and `keypoints.json`.

        Without a manifest a share `test_fraction` of the shapes, drawn by `split_seed`, is held
        out for testing; with one, the manifest's splits count.

        Raises
        ------
        MissingData
            The folder, its manifest's columns or its meshes are missing.
        BadMesh
            Meshes that are not closed genus-0 surfaces, one line each (on_bad=error).
        """
        root = Path(root)
        if not root.is_dir():
            raise MissingData(
                f"{root}: is not a folder; a folder of meshes is required; set shapes.root=FOLDER"
            )
        name = name or root.resolve().name
        if (root / "manifest.csv").is_file():
            shapes = _read_manifest(root)
        else:
            shapes = _with_split(_list_meshes(root, name), test_fraction, split_seed)
        keypoints = root / "keypoints.json"
        return cls(
            name,
            shapes,
            keypoints=keypoints if keypoints.is_file() else None,
            on_bad=on_bad,
            max_faces=max_faces,
            up=up,
            cache=cache,
        )

    @classmethod
    def from_blobs(
        cls,
        cache: Path | str,
        *,
        name: str = "blobs",
        on_bad: str = "error",
        max_faces: int | None = None,
        up: str = "y",
        **family: Any,
    ) -> "ShapeCollection":
        """The generated family of limbed blobs; `family` are the fields of `BlobFamily`."""
        root = generate_blobs(cache, BlobFamily(**family))
        return cls.from_folder(
            root, name=name, on_bad=on_bad, max_faces=max_faces, up=up, cache=cache
        )

    def __len__(self) -> int:
        return len(self._shapes)

    # Equal where the files are: copies in worker processes share what is cached per collection.
    def __eq__(self, other: object) -> bool:
        return isinstance(other, ShapeCollection) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    @property
    def _identity(self) -> tuple[Any, ...]:
        return self.name, tuple(self._shapes.values()), self._keypoint_file

    @cached_property
    def fingerprint(self) -> str:
        """Changes with any shape's file, split or ground truth: results belong to one of them."""
        files = [
            (s.id, s.split, _digest(s.path), _digest(s.correspondence))
            for s in self._shapes.values()
        ]
        return content_hash(self.name, files, _digest(self._keypoint_file))

    def ids(self, *splits: str) -> list[str]:
        """Ids of the given splits (all without arguments), in the collection's order."""
        return [s.id for s in self._shapes.values() if not splits or s.split in splits]

    def shape(self, id: str) -> Shape:
        """File, split and template of a shape.

        Raises
        ------
        MissingData
            No shape has this id.
        """
        if id not in self._shapes:
            raise MissingData(
                f"shape '{id}' is not in collection {self.name}; it has "
                f"{', '.join(list(self._shapes)[:5])}, …; name one of its {len(self)} shapes"
            )
        return self._shapes[id]

    def mesh(self, id: str) -> Mesh:
        """The mesh in its file's coordinates and vertex order, named by its id."""
        return replace(load_mesh(self.shape(id).path), name=id)

    def ground_truth(self, id: str) -> GroundTruth | None:
        """Dense ground truth of a shape, if the collection has it."""
        shape = self.shape(id)
        if shape.correspondence is None or shape.template is None:
            return None
        return load_ground_truth(shape.correspondence, shape.template)

    def keypoints(self, id: str) -> GroundTruth | None:
        """Semantic keypoints of a shape, shared by all templates, if the collection has them."""
        return self._keypoints.get(self.shape(id).id)

    @cached_property
    def _keypoints(self) -> dict[str, GroundTruth]:
        return {} if self._keypoint_file is None else load_keypoints(self._keypoint_file)


def _require_names(shapes: Sequence[Shape]) -> None:
    seen: dict[str, Path] = {}
    for shape in shapes:
        if shape.id in seen:
            raise Unsupported(
                f"{shape.path}: has the same id '{shape.id}' as {seen[shape.id]}; every shape "
                "needs an id of its own; rename one of the files"
            )
        if shape.id == SPHERE or "@" in shape.id:
            raise Unsupported(
                f"{shape.path}: the id '{shape.id}' is taken ('{SPHERE}' is S_0, '@' marks "
                "augmented shapes); another name is required; rename the file"
            )
        seen[shape.id] = shape.path


def _read_manifest(root: Path) -> list[Shape]:
    path = root / "manifest.csv"
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows or "file" not in rows[0]:
        raise MissingData(
            f"{path}: has no rows with a column 'file'; a manifest names file, split and "
            "optionally category and correspondence; complete it or remove it"
        )
    return [_shape(root, row, path) for row in rows]


def _shape(root: Path, row: dict[str, str], manifest: Path) -> Shape:
    split = row.get("split") or "train"
    if split not in SPLITS:
        raise MissingData(
            f"{manifest}: {row['file']} has the split '{split}'; one of {', '.join(SPLITS)} is "
            "required; correct the column"
        )
    dense = [part for part in (row.get("correspondence") or "").split(";") if part[-4:] == ".npz"]
    return Shape(
        id=Path(row["file"]).stem,
        path=root / row["file"],
        split=split,
        template=row.get("template") or row.get("category") or root.name if dense else None,
        correspondence=root / dense[0] if dense else None,
    )


def _list_meshes(root: Path, name: str) -> list[Shape]:
    folder = root / "meshes" if (root / "meshes").is_dir() else root
    files = [
        file
        for file in sorted(folder.rglob("*"))
        if file.suffix.lower() in FORMATS and not file.name.startswith(".")
    ]
    if not files:
        raise MissingData(
            f"{root}: holds no mesh; files in {', '.join(FORMATS)} are required; set "
            "shapes.root=FOLDER"
        )
    shapes = []
    for file in files:
        id = "_".join(file.relative_to(folder).with_suffix("").parts)
        dense = root / "corr" / f"{id}.npz"
        known = (name, dense) if dense.is_file() else (None, None)
        shapes.append(Shape(id, file, template=known[0], correspondence=known[1]))
    return shapes


def _with_split(shapes: list[Shape], test_fraction: float, seed: int) -> list[Shape]:
    held_out = round(test_fraction * len(shapes))
    if not 0 <= held_out < max(len(shapes), 1):
        raise Unsupported(
            f"shapes.test_fraction={test_fraction}: holds out {held_out} of {len(shapes)} shapes; "
            "at least one must be left for training; choose a share below 1"
        )
    test = set(np.random.default_rng(seed).permutation(len(shapes))[:held_out].tolist())
    return [
        replace(shape, split="test" if index in test else "train")
        for index, shape in enumerate(shapes)
    ]


def _digest(path: Path | None) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path is not None else ""
