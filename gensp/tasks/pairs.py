"""Pairs of spherical maps: implied correspondences against ground truth (paper §5.1)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from gensp.data.ground_truth import GroundTruth, common_points
from gensp.files import content_hash
from gensp.geometry.consistency import (
    GeneratedShape,
    HausdorffIndex,
    area_uniform_weights,
    prediction_error,
    sphere_uniform_weights,
)
from gensp.geometry.implied import MatchedMaps, frame_error, symmetric_error
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.pair_rotation import pair_rotation
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.sphere import sample_sphere
from gensp.geometry.spherical_map import SphericalMap

# The errors of a pair are kept at these quantiles, for the curve "fraction below x".
QUANTILES = (np.arange(64) + 0.5) / 64
GEODESICS = 512  # points of a pair, each way, whose error is measured along the surface, too
IN_FRAME = 2048  # points of a shape that are carried to another one without ground truth, at most
COINCIDE = 1e-9  # shapes at area 4π that are closer are one, but for rounding
Record = dict[str, Any]
Errors = tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]


class EvaluatedMap:
    """One map at area 4π with what all of its pairs share.

    Parameters
    ----------
    image
        The surface that the map was read off, if it was.
    symmetries
        Sets of keypoint ids that symmetries of the shape exchange; None: no shape of the
        collection has any, and no figure is made of them.
    """

    def __init__(
        self,
        map: SphericalMap,
        truth: GroundTruth | None = None,
        keypoints: GroundTruth | None = None,
        *,
        samples: int = 10_000,
        image: Mesh | None = None,
        symmetries: Sequence[Sequence[int]] | None = None,
    ) -> None:
        self.map = replace(map, surface=normalize(map.mesh).vertices)
        self.truth, self.keypoints, self.symmetries = truth, keypoints, symmetries
        self.prediction = None if image is None else GeneratedShape(self.map.mesh, image)
        self.samples = samples
        self.hausdorff = HausdorffIndex(self.map.mesh)

    @cached_property
    def signal(self) -> Complex[np.ndarray, "l o"]:
        """What the map is registered by where no ground truth may be used."""
        mesh = self.map.mesh
        return density_signal(self.map.sphere, mesh.faces, mesh.face_areas)

    @cached_property
    def weights(self) -> Mapping[str, Float[np.ndarray, " k"]]:
        """Ground-truth points as samples uniform on the sphere (c) and on the surface (c_area)."""
        if self.truth is None:
            return {}
        at, count = self.truth.at, self.samples
        return {
            "c": sphere_uniform_weights(self.map, at, count, np.random.default_rng(0)),
            "c_area": area_uniform_weights(self.map, at, count, np.random.default_rng(1)),
        }

    @cached_property
    def samples_in_frame(self) -> Mapping[str, SurfacePoints]:
        """Points uniform on the sphere and on the surface where no ground truth names any."""
        count = min(self.samples, IN_FRAME)
        on_sphere = sample_sphere(count, np.random.default_rng(0))
        areas = self.map.mesh.face_areas
        return {
            "c_frame": self.map.locate(on_sphere),
            "c_frame_area": sample_surface(areas, count, np.random.default_rng(1)),
        }


def pair_records(a: EvaluatedMap, b: EvaluatedMap) -> list[Record]:
    """What is measured between two maps; nothing where no ground truth joins them.

    Shapes of one template are compared at its dense points, others at semantic keypoints.
    """
    if a.truth and b.truth:
        rows, others = common_points(a.truth, b.truth)
        if len(rows):
            return [_dense(a, b, rows, others)]
    if a.keypoints and b.keypoints:
        rows, others = common_points(a.keypoints, b.keypoints)
        if len(rows):
            return [_sparse(a, b, rows, others)]
    return []


def frame_record(a: EvaluatedMap, b: EvaluatedMap) -> Record:
    """What is measured between two maps without any ground truth: c with x itself for m_ij(x).

    As they are, and after the rotation that is found from the maps alone; in both directions.
    """
    hausdorff = a.hausdorff.distance(b.hausdorff)
    # Of copies of one shape c is no number: rounding would be divided by rounding.
    scale = np.sqrt(a.map.mesh.area) / hausdorff if hausdorff > COINCIDE else np.nan
    registered = register_rotation(a.signal, b.signal, candidates=1)[0].rotation
    points = len(a.samples_in_frame["c_frame"])
    record: Record = {"kind": "frame", "points": points, "hausdorff": hausdorff}
    for suffix, turn in (("", np.eye(3)), ("_registered", registered)):
        for name, at in a.samples_in_frame.items():
            ahead = frame_error(a.map, b.map, at, turn)
            behind = frame_error(b.map, a.map, b.samples_in_frame[name], turn.T)
            record[name + suffix] = float(scale * _mean((ahead, behind)))
    return record


def _sparse(a: EvaluatedMap, b: EvaluatedMap, rows: np.ndarray, others: np.ndarray) -> Record:
    assert a.keypoints is not None
    assert b.keypoints is not None
    matched = MatchedMaps(a.map, b.map, a.keypoints.take(rows).at, b.keypoints.take(others).at)
    record, _ = _errors(a, b, matched)
    record |= _symmetric(a, b, matched, a.keypoints.ids[rows])
    hausdorff = a.hausdorff.distance(b.hausdorff)
    return {"kind": "keypoints", "points": len(rows), **record, "hausdorff": hausdorff}


def _symmetric(a: EvaluatedMap, b: EvaluatedMap, matched: MatchedMaps, ids: np.ndarray) -> Record:
    """The error without rotation where keypoints of a symmetry may be exchanged.

    Where a point is carried to, the symmetries of that shape count.
    """
    if a.symmetries is None or b.symmetries is None:
        return {}
    at_a, at_b = matched.at_i, matched.at_j
    there = symmetric_error(a.map, b.map, at_a, at_b, _places(b.symmetries, ids))
    back = symmetric_error(b.map, a.map, at_b, at_a, _places(a.symmetries, ids))
    return {"error_symmetric": _mean((there, back))}


def _places(groups: Sequence[Sequence[int]], ids: np.ndarray) -> list[list[int]]:
    """Places of the members of every group among the points that are compared."""
    return [np.flatnonzero(np.isin(ids, group)).tolist() for group in groups]


def _dense(a: EvaluatedMap, b: EvaluatedMap, rows: np.ndarray, others: np.ndarray) -> Record:
    assert a.truth is not None
    assert b.truth is not None
    matched = MatchedMaps(a.map, b.map, a.truth.take(rows).at, b.truth.take(others).at)
    record, turns = _errors(a, b, matched)
    hausdorff = a.hausdorff.distance(b.hausdorff)
    record = {"kind": "dense", "points": len(rows), **record, "hausdorff": hausdorff}
    scale = np.sqrt(a.map.mesh.area) / hausdorff if hausdorff > 0 else np.nan
    drawn = matched.drawn(GEODESICS, seed=int(content_hash(a.map.name, b.map.name), 16))
    for suffix, (_, (there, back)) in turns.items():
        for name in ("c", "c_area"):
            ahead = _weighted(there, a.weights[name][rows])
            behind = _weighted(back, b.weights[name][others])
            record[name + suffix] = float(scale * (ahead + behind) / 2)
        record["quantiles" + suffix] = _quantiles((there, back))
    for suffix in ("", "_rotated"):
        along = drawn.geodesic_errors(turns[suffix][0])
        record["geodesic" + suffix] = _mean(along)
        record["quantiles_geodesic" + suffix] = _quantiles(along)
    return record


def _weighted(values: Float[np.ndarray, " k"], weights: Float[np.ndarray, " k"]) -> float:
    return float(values @ weights / weights.sum()) if weights.sum() > 0 else float("nan")


def _mean(errors: Errors) -> float:
    there, back = errors
    return float((there.mean() + back.mean()) / 2)


def _quantiles(errors: Errors) -> list[float]:
    return [float(f"{value:.4g}") for value in np.quantile(np.concatenate(errors), QUANTILES)]


def _errors(
    a: EvaluatedMap, b: EvaluatedMap, matched: MatchedMaps
) -> tuple[Record, dict[str, tuple[np.ndarray, Errors]]]:
    """Implied-correspondence errors in both directions, without rotation and with two.

    Returns
    -------
    record, turns
        Means and maxima; the rotations with the errors after them.
    """
    turns = _turns(a, b, matched)
    record: Record = {}
    for suffix, (_, errors) in turns.items():
        record["error" + suffix] = _mean(errors)
        record["error_max" + suffix] = float(np.max(errors))
    if a.prediction and b.prediction:
        at_a, at_b = matched.at_i, matched.at_j
        there = prediction_error(a.prediction, b.prediction, at_a, at_b)
        back = prediction_error(b.prediction, a.prediction, at_b, at_a)
        record["error_prediction"] = _mean((there, back))
    return record, turns


def _turns(
    a: EvaluatedMap, b: EvaluatedMap, matched: MatchedMaps
) -> dict[str, tuple[np.ndarray, Errors]]:
    """The identity, a rotation found without the ground truth, and the best that is found by it.

    None of the others that are measured has a smaller mean error than the last.
    """
    registered = register_rotation(a.signal, b.signal, candidates=1)[0].rotation
    known = [(turn, matched.errors(turn)) for turn in (np.eye(3), registered)]
    squares = matched.least_squares()
    searched = pair_rotation(matched, [squares, registered])
    more = [(turn, matched.errors(turn)) for turn in (squares, searched)]
    best = min([*known, *more], key=lambda found: _mean(found[1]))
    return {"": known[0], "_registered": known[1], "_rotated": best}
