"""Semantic keypoints in KeypointNet's records, which all shapes of a collection share.

Source of the format: You et al., KeypointNet: A Large-scale 3D Keypoint Dataset Aggregated from
Numerous Human Annotations, 2020.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from gensp.data.ground_truth import GroundTruth, ground_truth
from gensp.errors import DamagedFile, MissingData
from gensp.files import read_json

if TYPE_CHECKING:
    from gensp.geometry.distance import ClosestPoints
    from gensp.geometry.mesh import Mesh

KEYPOINTS = "keypoints"
_FOREIGN = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
Record = Mapping[str, Any]


def load_keypoint_records(path: Path | str) -> dict[str, Record]:
    """Read a list of records; model_id → record.

    Raises
    ------
    MissingData
        The file is no list of records with class_id, model_id and keypoints.
    """
    try:
        return {_model(record): record for record in read_json(path)}
    # What a parser of foreign records may meet, besides a file that is not there or no JSON.
    except (OSError, DamagedFile, *_FOREIGN) as error:
        raise MissingData(
            f"{path}: is no list of keypoint records ({type(error).__name__}: {error}); model_id "
            "and keypoints with xyz, semantic_id and mesh_info are required; replace the file"
        ) from error


# Kept: every item arrives in a worker with a collection of its own.
@lru_cache(maxsize=1)
def read_annotations(root: Path) -> tuple[dict[str, Record], dict[str, str]]:
    """KeypointNet's records of all categories, and what is wrong with those left out.

    Both by <class id>_<model id>.

    Raises
    ------
    MissingData
        The folder has no annotations, or a file of them has no record that can be read.
    """
    files = sorted((root / "annotations").glob("*.json"))
    if not files:
        raise MissingData(
            f"{root}: has no annotations/*.json; KeypointNet's folder is required; set "
            "shapes.keypoints=FOLDER"
        )
    records: dict[str, Record] = {}
    faults: dict[str, str] = {}
    for path in files:
        try:
            listed = read_json(path)
            found = {_key(record): _fault(record) for record in listed}
        except (OSError, DamagedFile, *_FOREIGN):
            found = {}
        if not any(fault is None for fault in found.values()):
            load_keypoint_records(path)  # tells what is wrong with the file or its first record
        faults |= {id: fault for id, fault in found.items() if fault is not None}
        records |= {_key(record): record for record in listed if found[_key(record)] is None}
    return records, faults


def _key(record: Any) -> str:
    known = record if isinstance(record, Mapping) else {}
    return f"{known.get('class_id')}_{known.get('model_id')}"


def _fault(record: Record) -> str | None:
    """What makes a record unreadable; None where nothing does."""
    try:
        _model(record)
    except _FOREIGN as error:
        return f"{type(error).__name__}: {error}"
    return None


def _model(record: Record) -> str:
    for point in record["keypoints"]:
        lacking = {"semantic_id", "xyz", "mesh_info"} - point.keys()
        if lacking:
            raise KeyError(f"{record['model_id']} has a keypoint without {min(lacking)}")
    # What is read of it later is read here once, so that a fault is told with the file's name.
    _positions(record), symmetry_groups(record)
    if not np.isfinite(keypoints_of(record).at.barycentric).all():
        raise ValueError(f"{record['model_id']} has a face_uv that is no weight")
    return str(record["model_id"])


def keypoints_of(record: Record) -> GroundTruth:
    """Semantic ids and places of a record; a face of -1 means that the mesh lacks the point."""
    points = [point for point in record["keypoints"] if point["mesh_info"]["face_index"] >= 0]
    return ground_truth(
        KEYPOINTS,
        [point["semantic_id"] for point in points],
        [point["mesh_info"]["face_index"] for point in points],
        [point["mesh_info"]["face_uv"] for point in points],
    )


def symmetry_groups(record: Record) -> list[tuple[int, ...]]:
    """Sets of semantic ids that a reflection or rotation of the shape exchanges."""
    ids = [point["semantic_id"] for point in record["keypoints"]]
    symmetries = record.get("symmetries") or {}
    listed = [*symmetries.get("reflection", ()), *symmetries.get("rotation", ())]
    return [tuple(ids[place] for place in entry["kp_indexes"]) for entry in listed]


def symmetry_orbits(groups: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    """The groups, those with a member in common joined: what any chain of symmetries exchanges."""
    orbits: list[set[int]] = []
    for group in groups:
        met = [orbit for orbit in orbits if orbit & set(group)]
        orbits = [orbit for orbit in orbits if orbit not in met] + [set(group).union(*met)]
    return [tuple(sorted(orbit)) for orbit in orbits]


@dataclass(frozen=True)
class CarriedKeypoints:
    """Keypoints on another mesh of a shape, and how far they lie from it, in diagonals."""

    record: Record
    distance: Float[np.ndarray, " k"]


def keypoint_distance(record: Record, mesh: "Mesh") -> float:
    """Largest distance of a keypoint to the surface it should lie on, in diagonals.

    Models whose annotation was made in another pose or scale show it here.
    """
    return float(_distances(record, mesh)[1].max())


def carry_keypoints(
    record: Record, id: str, mesh: "Mesh", final: "Mesh", *, largest: float
) -> CarriedKeypoints:
    """The record of a mesh of the same surface, symmetries included.

    Parameters
    ----------
    mesh, final
        The other mesh in the coordinates of the record, and in those that are written.
    largest
        Keypoints further from the mesh, in its diagonals, get the face -1.
    """
    found, distance = _distances(record, mesh)
    places = found.at.on(final.vertices, final.faces)
    points = []
    for k, point in enumerate(record["keypoints"]):
        face = int(found.at.faces[k]) if distance[k] <= largest else -1
        info = {"face_index": face, "face_uv": found.at.barycentric[k].tolist()}
        here = {"xyz": places[k].tolist(), "mesh_info": info, "pcd_info": {"point_index": -1}}
        points.append({**point, **here})
    return CarriedKeypoints({**record, "model_id": id, "keypoints": points}, distance)


def _distances(record: Record, mesh: "Mesh") -> tuple["ClosestPoints", Float[np.ndarray, " k"]]:
    """Closest points of the mesh to the keypoints, and how far they are, in its diagonals."""
    # Imported late: who only reads records needs no geometry.
    from gensp.geometry.distance import closest_point
    from gensp.geometry.repair import bounding_diagonal

    found = closest_point(_positions(record), mesh)
    return found, found.distance / bounding_diagonal(mesh)


def _positions(record: Record) -> Float[np.ndarray, "k 3"]:
    listed = [point["xyz"] for point in record["keypoints"]]
    return np.array(listed, dtype=np.float64).reshape(-1, 3)
