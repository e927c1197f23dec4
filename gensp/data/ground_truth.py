"""Known correspondences: template vertices and keypoints placed on each mesh.

Two shapes of one template correspond where their ids agree.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from gensp.errors import MissingData
from gensp.files import load_npz, save_npz
from gensp.geometry.points import SurfacePoints

if TYPE_CHECKING:
    from gensp.geometry.mesh import Mesh


@dataclass(frozen=True)
class GroundTruth:
    """k points of one mesh with their ids (k,) in a template that several meshes share."""

    template: str
    ids: Int[np.ndarray, " k"]
    at: SurfacePoints

    def take(self, index: np.ndarray) -> "GroundTruth":
        """The points at `index` (integers or a mask)."""
        return GroundTruth(self.template, self.ids[index], self.at.take(index))


def common_points(
    first: GroundTruth, second: GroundTruth
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Rows of `first` and `second` that are the same points; none without a shared template."""
    if first.template != second.template:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    _, rows, others = np.intersect1d(first.ids, second.ids, return_indices=True)
    return rows, others


def load_ground_truth(path: Path | str, template: str) -> GroundTruth:
    """Read `template_vertex`, `face`, `bary` of an npz; rows with face -1 have no match.

    Raises
    ------
    MissingData
        The file or one of its arrays is missing, or they do not belong together.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingData(
            f"{path}: does not exist; the manifest names it as ground truth; restore the file or "
            "empty the column 'correspondence'"
        )
    arrays = load_npz(path)
    missing = {"template_vertex", "face", "bary"} - arrays.keys()
    if missing:
        raise MissingData(
            f"{path}: arrays {', '.join(sorted(missing))} are missing; ground truth has "
            "template_vertex (k), face (k) and bary (k, 3); write them or remove the file"
        )
    _require_rows(path, arrays)
    known = arrays["face"] >= 0
    return ground_truth(
        template, arrays["template_vertex"][known], arrays["face"][known], arrays["bary"][known]
    )


def _require_rows(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    ids, faces, weights = (arrays[name] for name in ("template_vertex", "face", "bary"))
    whole = {ids.dtype.kind, faces.dtype.kind} <= set("iu") and weights.dtype.kind == "f"
    if not whole or ids.shape != faces.shape or weights.shape != (*faces.shape, 3):
        raise MissingData(
            f"{path}: arrays of {ids.dtype} {ids.shape}, {faces.dtype} {faces.shape} and "
            f"{weights.dtype} {weights.shape}; template_vertex (k) and face (k) of integers and "
            "bary (k, 3) are required; write them again or remove the file"
        )
    sums = np.clip(weights[faces >= 0], 0, None).sum(axis=-1)
    if faces.ndim != 1 or not (np.isfinite(sums) & (sums > 0)).all():
        raise MissingData(
            f"{path}: barycentric coordinates that are no weights; finite ones, not all zero, are "
            "required; write them again or remove the file"
        )


def ground_truth(template: str, ids: Any, faces: Any, weights: Any) -> GroundTruth:
    """Points from lists or arrays as files hold them; weights are made to sum to one."""
    weights = np.clip(np.asarray(weights, dtype=np.float64).reshape(-1, 3), 0, None)
    weights = weights / weights.sum(axis=1, keepdims=True)
    at = SurfacePoints(np.asarray(faces, dtype=np.int64).reshape(-1), weights)
    return GroundTruth(template, np.asarray(ids, dtype=np.int64).reshape(-1), at)


def save_ground_truth(path: Path | str, truth: GroundTruth) -> None:
    """Write the format that `load_ground_truth` reads."""
    save_npz(
        path,
        template_vertex=truth.ids.astype(np.int32),
        face=truth.at.faces.astype(np.int32),
        bary=truth.at.barycentric,
    )


def carry_ground_truth(
    truth: GroundTruth, source: "Mesh", target: "Mesh", *, largest: float
) -> tuple[GroundTruth, Float[np.ndarray, " k"]]:
    """The points of one mesh at the closest places of another mesh of the same surface.

    Parameters
    ----------
    largest
        Points that move further, in diagonals of the source's bounding box, are left out.

    Returns
    -------
    GroundTruth, (k,) array
        The points on the target, and how far every point of the source was moved, in diagonals.
    """
    # Imported late: who only asks what is known needs no geometry.
    from gensp.geometry.distance import closest_point
    from gensp.geometry.repair import bounding_diagonal

    points = truth.at.on(source.vertices, source.faces)
    found = closest_point(points, target)
    moved = found.distance / bounding_diagonal(source)
    return GroundTruth(truth.template, truth.ids, found.at).take(moved <= largest), moved
