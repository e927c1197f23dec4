"""Preparing one mesh of a raw collection: check, mend, carry its ground truth, write."""

import json
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gensp.compute import Row
from gensp.data.ground_truth import GroundTruth, carry_ground_truth, save_ground_truth
from gensp.data.keypoints import Record, carry_keypoints, keypoint_distance, symmetry_groups
from gensp.data.raw import RawCollection
from gensp.errors import BadMesh, DamagedFile, GenSPError
from gensp.files import atomic_path, content_hash, load_npz, save_npz, write_json
from gensp.geometry.mesh import MAX_FACES, Mesh, normalize
from gensp.geometry.ply import ply_bytes
from gensp.geometry.points import SurfacePoints
from gensp.geometry.preparation import DROPPED, Preparation, Prepared, words
from gensp.layout import item_folder, keyed_path

# Raised when the same input is to give other output.
_VERSION = 3
KINDS = {"meshes": ".ply", "corr": ".npz", "keypoints": ".json"}  # the ends of their names


@dataclass(frozen=True)
class Bundle:
    """All that is kept of one prepared mesh; nothing but its row if it was dropped."""

    row: Row
    mesh: Mesh | None = None
    truth: GroundTruth | None = None
    record: Record | None = None


@dataclass(frozen=True)
class Prepare:
    """Write meshes/<id>.ply, corr/<id>.npz and keypoints/<id>.json of one mesh.

    Attributes
    ----------
    preparation
        What is done to a mesh.
    normalize
        Centre it and scale it to the area of the unit sphere.
    truth_distance
        Points of the ground truth that move further, in diagonals, are left out.
    keypoint_distance
        A model with a keypoint further from its surface than this, in diagonals, is misaligned:
        its keypoints are not used.
    cache
        Folder of what was prepared before, by the content of the files and these settings.
    """

    collection: RawCollection
    folder: Path
    preparation: Preparation
    normalize: bool = False
    truth_distance: float = 0.02
    keypoint_distance: float = 0.05
    seed: int = 0
    cache: Path | None = None

    def __call__(self, id: str) -> Row:
        """Prepare the mesh, or take what is kept of it; see the stage for the row.

        Raises
        ------
        GenSPError
            The mesh or its ground truth led to an error, of whatever kind.
        """
        start = time.perf_counter()
        with _blamed_on(id):
            kept = self._kept(id)
            found = _loaded(kept, id)
            bundle = found or self._made(id)
        cached = found is not None
        if kept is not None and not cached:
            _save(bundle, kept)
        self._write(id, bundle)
        return bundle.row | {"cached": cached, "seconds": round(time.perf_counter() - start, 3)}

    def _kept(self, id: str) -> Path | None:
        if self.cache is None:
            return None
        distances = self.normalize, self.truth_distance, self.keypoint_distance
        settings = asdict(self.preparation), distances, self.seed
        key = content_hash(_VERSION, id, self.collection.digest(id), settings)
        return keyed_path(self.cache / "prepared", key, ".npz")

    def _made(self, id: str) -> Bundle:
        try:
            mesh = self.collection.mesh(id)
        except BadMesh as error:
            # The file alone: where it was is no property of the collection that is written.
            reason = " ".join(str(error).split())
            file = Path(reason.split(": ")[0])
            if file.is_absolute():
                reason = reason.removeprefix(f"{file.parent}/")
            return Bundle({"id": id, "verdict": DROPPED, "reason": reason})
        # Seeded by the name, so that a mesh does not depend on the rest of the collection.
        generator = np.random.default_rng(int(content_hash(id, self.seed), 16))
        found = self.preparation(mesh, generator)
        row = {"id": id, **_row(found)}
        if found.mesh is None:
            return Bundle(row)
        return self._with_truth(id, mesh, found, row)

    def _with_truth(self, id: str, raw: Mesh, found: Prepared, row: Row) -> Bundle:
        mesh = found.mesh
        assert mesh is not None
        final = normalize(mesh) if self.normalize else mesh
        truth, dense = self._dense(id, raw, mesh)
        record, sparse = self._keypoints(id, raw, mesh, final)
        done = "; ".join([*found.done, *["normalised"] * self.normalize])
        return Bundle({**row, "done": done, **dense, **sparse}, final, truth, record)

    def _dense(self, id: str, raw: Mesh, mesh: Mesh) -> tuple[GroundTruth | None, Row]:
        truth = self.collection.ground_truth(id)
        if truth is None:
            return None, {}
        if mesh.faces is raw.faces:
            return truth, {"truth": len(truth.ids), "truth_moved": 0.0}
        carried, moved = carry_ground_truth(truth, raw, mesh, largest=self.truth_distance)
        return carried, {"truth": len(carried.ids), "truth_moved": round(float(moved.max()), 6)}

    def _keypoints(self, id: str, raw: Mesh, mesh: Mesh, final: Mesh) -> tuple[Record | None, Row]:
        record = self.collection.keypoint_record(id)
        if record is None or not record["keypoints"]:
            return None, {}
        off = keypoint_distance(record, raw)
        row: Row = {"keypoints_off": round(off, 6), "misaligned": off > self.keypoint_distance}
        if row["misaligned"]:
            return None, {"keypoints": 0, **row}
        carried = carry_keypoints(record, id, mesh, final, largest=self.keypoint_distance)
        used = int((carried.distance <= self.keypoint_distance).sum())
        return carried.record, {
            "keypoints": used,
            "symmetries": len(symmetry_groups(record)),
            **row,
        }

    def _write(self, id: str, bundle: Bundle) -> None:
        if bundle.mesh is not None:
            with atomic_path(prepared_path(self.folder, "meshes", id)) as temporary:
                mesh = bundle.mesh
                temporary.write_bytes(ply_bytes("xyz", mesh.vertices, mesh.faces))
        if bundle.truth is not None:
            save_ground_truth(prepared_path(self.folder, "corr", id), bundle.truth)
        if bundle.record is not None:
            write_json(prepared_path(self.folder, "keypoints", id), bundle.record)


@contextmanager
def _blamed_on(id: str) -> Iterator[None]:
    """Errors of any kind as one of ours: one mesh must not cost the others their collection."""
    try:
        yield
    except GenSPError:
        raise
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        met = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        raise GenSPError(
            f"{id}: an unexpected error was met ({met}; {Path(where.filename).name}, line "
            f"{where.lineno}); a mesh that can be prepared is required; mend it, or leave it out"
        ) from error


def prepared_path(folder: Path, kind: str, id: str) -> Path:
    """Where the meshes, the ground truth ("corr") or the keypoints of a collection are written."""
    return item_folder(folder, kind, id) / f"{id}{KINDS[kind]}"


def _row(found: Prepared) -> Row:
    mesh = found.mesh
    far = found.hausdorff
    return {
        "verdict": found.verdict,
        "found": words(found.found),
        "done": "; ".join(found.done),
        "hausdorff": None if far is None else round(far, 6),
        "vertices_before": found.found.vertices,
        "faces_before": found.found.faces,
        "components_before": found.found.components,
        "genus_before": found.found.genus,
        "self_intersecting_before": found.self_intersecting,
        "vertices": None if mesh is None else len(mesh.vertices),
        "faces": None if mesh is None else len(mesh.faces),
        "reason": found.reason,
        "remedy": found.remedy,
    }


def _save(bundle: Bundle, path: Path) -> None:
    arrays: dict[str, Any] = {"row": json.dumps(bundle.row), "record": json.dumps(bundle.record)}
    if bundle.mesh is not None:
        arrays |= {"vertices": bundle.mesh.vertices, "faces": bundle.mesh.faces}
    if bundle.truth is not None:
        truth = bundle.truth
        arrays |= {"template": truth.template, "ids": truth.ids}
        arrays |= {"face": truth.at.faces, "bary": truth.at.barycentric}
    save_npz(path, **arrays)


def _loaded(path: Path | None, id: str) -> Bundle | None:
    """What is kept; None where nothing is, or where it is damaged and has to be made again."""
    if path is None or not path.is_file():
        return None
    try:
        arrays = load_npz(path)
        row, record = (json.loads(str(arrays[key])) for key in ("row", "record"))
        mesh = Mesh(arrays["vertices"], arrays["faces"], id) if "vertices" in arrays else None
        truth = None
        if "ids" in arrays:
            at = SurfacePoints(arrays["face"], arrays["bary"])
            truth = GroundTruth(str(arrays["template"]), arrays["ids"], at)
        return Bundle(row, mesh, truth, record)
    except (OSError, ValueError, KeyError, DamagedFile):
        return None


def prepare_task(
    *,
    inputs: Mapping[str, Any],
    folder: Path,
    collection: RawCollection,
    repair: list[str],
    weld: float,
    largest_hole: float,
    solid: Mapping[str, Any],
    vertices: int | None,
    remesh: bool,
    max_faces: int | None,
    cache: str | Path | None,
    **settings: Any,
) -> Prepare:
    """The task as the configuration gives it."""
    # Typed as 0 it is no float.
    distances = ("largest_radius", "largest_distance")
    solid = {**solid, **{key: float(solid[key]) for key in distances}}
    preparation = Preparation(
        tuple(repair), weld, largest_hole, solid, vertices, remesh, max_faces or MAX_FACES
    )
    kept = None if cache is None else Path(cache)
    return Prepare(collection, Path(folder), preparation, cache=kept, **settings)


def prepare_items(
    *, inputs: Mapping[str, Any], folder: Path, collection: RawCollection
) -> list[str]:
    """Ids of all meshes."""
    return collection.ids()
