"""Collections of genus-0 meshes: which shapes, which split, which ground truth.

A collection is a folder. A `manifest.csv` in it names the meshes, their splits and their
correspondence files; without one, every ply, obj, off and stl file is a shape.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gensp.data.folder import Shape, list_meshes, read_manifest, with_split
from gensp.data.ground_truth import GroundTruth, common_points, load_ground_truth
from gensp.data.keypoints import (
    keypoints_of,
    load_keypoint_records,
    symmetry_groups,
    symmetry_orbits,
)
from gensp.data.validation import checked
from gensp.errors import MissingData, Unsupported
from gensp.files import content_hash, read_rows

if TYPE_CHECKING:
    from gensp.geometry.mesh import Mesh
    from gensp.geometry.points import SurfacePoints

SPHERE = "sphere"


class ShapeCollection:
    """Checked shapes with their splits and ground truth; see `from_folder`.

    Attributes
    ----------
    skipped
        (id, reason) of the meshes that were left out under on_bad=skip. Under on_bad=keep nothing
        is checked: for `stage=prepare`, which does that itself.
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
            shapes = read_manifest(root)
        else:
            shapes = with_split(list_meshes(root, name), test_fraction, split_seed)
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
        # Imported late, like load_mesh below: a finished stage asks for the files alone.
        from gensp.data.blobs import BlobFamily, generate_blobs

        root = generate_blobs(cache, BlobFamily(**family))
        return cls.from_folder(
            root, name=name, on_bad=on_bad, max_faces=max_faces, up=up, cache=cache
        )

    def __len__(self) -> int:
        return len(self._shapes)

    # Equal where the files are: copies in worker processes share what is cached per collection.
    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, ShapeCollection) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash((self.name, len(self._shapes), self._keypoint_file))

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
        # A list that is not there changes no fingerprint.
        left_out = [_digest(self._misaligned)] if self._misaligned else []
        return content_hash(self.name, files, _digest(self._keypoint_file), *left_out)

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

    def mesh(self, id: str) -> "Mesh":
        """The mesh in its file's coordinates and vertex order, named by its id."""
        from gensp.geometry.mesh import load_mesh

        return replace(load_mesh(self.shape(id).path), name=id)

    def ground_truth(self, id: str) -> GroundTruth | None:
        """Dense ground truth of a shape, if the collection has it."""
        shape = self.shape(id)
        if shape.correspondence is None or shape.template is None:
            return None
        return load_ground_truth(shape.correspondence, shape.template)

    def keypoints(self, id: str) -> GroundTruth | None:
        """Semantic keypoints of a shape, shared by all templates, if the collection has them."""
        record = self.keypoint_record(id)
        return None if record is None else keypoints_of(record)

    @cached_property
    def has_truth(self) -> bool:
        """Whether any shape has dense ground truth or semantic keypoints."""
        return any(
            shape.correspondence is not None or self.keypoint_record(id) is not None
            for id, shape in self._shapes.items()
        )

    def points_in_common(
        self, first: str, second: str
    ) -> tuple["SurfacePoints", "SurfacePoints", bool] | None:
        """The same points on two shapes, and whether they are dense; else they are keypoints.

        None where no ground truth joins the two.
        """
        for known, dense in ((self.ground_truth, True), (self.keypoints, False)):
            one, other = known(first), known(second)
            if one is not None and other is not None:
                rows, others = common_points(one, other)
                if len(rows):
                    return one.take(rows).at, other.take(others).at, dense
        return None

    def keypoint_record(self, id: str) -> Mapping[str, Any] | None:
        """The same as the record of `keypoints.json`, symmetries included."""
        return self._records.get(self.shape(id).id)

    def symmetries(self, id: str) -> list[tuple[int, ...]] | None:
        """Sets of semantic ids that symmetries of the shape exchange; None: no shape has any."""
        if not self._symmetric:
            return None
        record = self.keypoint_record(id)
        return [] if record is None else symmetry_orbits(symmetry_groups(record))

    def digest(self, id: str) -> str:
        """Changes with the shape's file or its ground truth."""
        shape = self.shape(id)
        files = _digest(shape.path), _digest(shape.correspondence)
        return content_hash(shape.path.suffix, files, self.keypoint_record(id))

    def unread_keypoints(self) -> dict[str, str]:
        """None: one that cannot be read ends the reading."""
        return {}

    def columns(self, id: str) -> dict[str, str]:
        """What the manifest tells of a shape: category, subject, source, licence and the like."""
        shape = self.shape(id)
        template = {} if shape.template is None else {"template": shape.template}
        return {**dict(shape.columns), **template}

    def splits(self, ids: Sequence[str]) -> dict[str, str]:
        """Split of each of some shapes."""
        return {id: self.shape(id).split for id in ids}

    @cached_property
    def _records(self) -> dict[str, Mapping[str, Any]]:
        """Keypoint records, but for the models that misaligned.csv lists."""
        if self._keypoint_file is None:
            return {}
        wrong = _listed(self._misaligned) if self._misaligned else set()
        records = load_keypoint_records(self._keypoint_file)
        return {id: record for id, record in records.items() if id not in wrong}

    @cached_property
    def _symmetric(self) -> bool:
        return any(symmetry_groups(record) for record in self._records.values())

    @property
    def _misaligned(self) -> Path | None:
        """The list of models whose keypoints do not lie on them, as stage=prepare leaves it."""
        path = self._keypoint_file and self._keypoint_file.with_name("misaligned.csv")
        return path if path and path.is_file() else None


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


def _digest(path: Path | None) -> str:
    found = path is not None and path.is_file()
    return hashlib.sha256(path.read_bytes()).hexdigest() if path and found else ""


def _listed(path: Path) -> set[str]:
    """The ids of a table."""
    rows = read_rows(path)
    if rows and "id" not in rows[0]:
        raise MissingData(f"{path}: has the columns {', '.join(rows[0])}; a column id is required")
    return {row["id"] for row in rows}
