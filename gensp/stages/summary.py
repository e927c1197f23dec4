"""From rows of shapes and pairs to the figures of the table (paper §5.1), split by split."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gensp.geometry.consistency import nearest_neighbours

GROUPS = ("train", "val", "test", "all")
NORMALIZATION = "surface and sphere triangulations scaled to total area 4π, chordal triangles"
THRESHOLDS = np.linspace(0, 0.25, 101)  # over √area, as far as Kim et al. (2011) draw
WITHIN = 0.05  # the error at which shares of points are told
_TURNS = ("", "_rotated", "_registered")
_POINTS = (*("error" + turn for turn in _TURNS), "error_prediction")
_DENSE = (*_POINTS, "geodesic", "geodesic_rotated")
_SPARSE = (*_POINTS, "error_symmetric")
_CURVES = {
    **{"raw": "", "rotated": "_rotated", "registered": "_registered"},
    **{"geodesic_raw": "_geodesic", "geodesic_rotated": "_geodesic_rotated"},
}
_NEIGHBOURS = tuple(name + turn for name in ("c", "c_area") for turn in _TURNS)
_FRAME = tuple(name + turn for name in ("c_frame", "c_frame_area") for turn in ("", "_registered"))

Record = dict[str, Any]


def members(rows: Iterable[Mapping[str, Any]], group: str) -> list[str]:
    """Ids of a group's shapes; "all" are all of them."""
    return [str(row["id"]) for row in rows if group in ("all", row["split"])]


def mark_neighbours(pairs: Sequence[Record], rows: Sequence[Record], count: int) -> None:
    """Add to every pair whether it joins nearest neighbours: among all, and within its split."""
    for group in GROUPS:
        mark = "neighbour" if group == "all" else "neighbour_in_group"
        ids = members(rows, group)
        if len(ids) < 2:
            continue
        place = {id: index for index, id in enumerate(ids)}
        inside = [pair for pair in pairs if group in ("all", pair["group"])]
        distances = np.full((len(ids), len(ids)), np.inf)
        for pair in inside:
            i, j = place[pair["first"]], place[pair["second"]]
            distances[i, j] = distances[j, i] = pair["hausdorff"]
        joined = nearest_neighbours(distances, count)
        for pair in inside:
            pair[mark] = bool(joined[place[pair["first"]], place[pair["second"]]])


def group_figures(
    rows: Sequence[Record], pairs: Sequence[Record], group: str
) -> dict[str, float | int]:
    """All figures of one group of shapes."""
    ids = set(members(rows, group))
    shapes = [row for row in rows if row["id"] in ids]
    mark = "neighbour" if group == "all" else "neighbour_in_group"
    inside = [pair for pair in pairs if group in ("all", pair["group"])]
    dense = [pair for pair in inside if pair["kind"] == "dense"]
    near = [pair for pair in dense if pair.get(mark)]
    keypoints = [pair for pair in inside if pair["kind"] == "keypoints"]
    return {
        **_shape_figures(shapes),
        "pairs": len(dense),
        **_means(dense, _DENSE),
        **{
            f"{key}_median": _statistic(np.median, dense, key)
            for key in _DENSE
            if _values(dense, key)
        },
        **_shares(dense),
        "neighbour_pairs": len(near),
        **_means(near, _NEIGHBOURS),
        "keypoint_pairs": len(keypoints),
        **{f"keypoint_{key}": value for key, value in _means(keypoints, _SPARSE).items()},
        **_frame_figures(inside, mark),
    }


def _frame_figures(inside: Sequence[Record], mark: str) -> dict[str, float | int]:
    """Figures of a collection without ground truth; nothing of one that has any."""
    pairs = [pair for pair in inside if pair["kind"] == "frame"]
    near = [pair for pair in pairs if pair.get(mark)]
    counts = {"frame_pairs": len(pairs), "frame_neighbour_pairs": len(near)}
    return {**_means(near, _FRAME), **counts} if pairs else {}


def _shares(dense: Sequence[Record]) -> dict[str, float]:
    """Share of the points whose error along the surface is at most `WITHIN`."""
    known = [pair for pair in dense if "quantiles_geodesic" in pair]
    return {
        f"within{turn}": float(
            np.mean([np.less_equal(pair["quantiles_geodesic" + turn], WITHIN) for pair in known])
        )
        for turn in ("", "_rotated")
        if known
    }


def _shape_figures(rows: Sequence[Record]) -> dict[str, float | int]:
    bad = sum(row["bad_faces"] for row in rows)
    largest = ("sigma_max", "conformal_max", "coverage_max", "prediction_coverage_max")
    sizes = ("seconds", "processor_seconds", "vertices")
    means = ("sigma_mean", "sigma_area", "conformal_mean", "coverage_mean", "seconds")
    return {
        "shapes": len(rows),
        **_means(rows, (*means, "prediction_coverage_mean")),
        "sigma_max_mean": _statistic(np.mean, rows, "sigma_max"),
        **{key: _statistic(np.max, rows, key) for key in largest if _values(rows, key)},
        **{
            f"{key}_median": _statistic(np.median, rows, key)
            for key in sizes
            if _values(rows, key)
        },
        **{f"{key}_max": _statistic(np.max, rows, key) for key in sizes if _values(rows, key)},
        "bad_faces": bad,
        "bad_faces_percent": 100 * bad / max(1, sum(row["faces"] for row in rows)),
        "wrong_degree": sum(abs(row["degree"]) != 1 for row in rows),
        "affected_shapes": sum(row["bad_faces"] > 0 or abs(row["degree"]) != 1 for row in rows),
    }


def _means(records: Sequence[Record], keys: Iterable[str]) -> dict[str, float]:
    return {key: _statistic(np.mean, records, key) for key in keys if _values(records, key)}


def _values(records: Sequence[Record], key: str) -> list[float]:
    found = (record.get(key) for record in records)
    return [float(value) for value in found if value is not None and not math.isnan(value)]


def _statistic(statistic: Any, records: Sequence[Record], key: str) -> float:
    return float(statistic(_values(records, key)))


def error_curves(pairs: Sequence[Record]) -> dict[str, Any]:
    """For every group the fraction of ground-truth points whose error is at most a threshold.

    Straight and along the surface, without a rotation and with either one.
    """
    curves: dict[str, Any] = {}
    for group in GROUPS:
        dense = [p for p in pairs if p["kind"] == "dense" and group in ("all", p["group"])]
        if dense:
            curves[group] = {
                name: _fractions([pair["quantiles" + kind] for pair in dense])
                for name, kind in _CURVES.items()
            }
    return {"thresholds": THRESHOLDS.round(6).tolist(), **curves} if curves else {}


def _fractions(errors: Sequence[Sequence[float]]) -> list[float]:
    ordered = np.sort(np.concatenate([np.asarray(part) for part in errors]))
    below = np.searchsorted(ordered, THRESHOLDS, side="right") / len(ordered)
    return [float(value) for value in below.round(6)]


def summarize(
    rows: Sequence[Record], pairs: Sequence[Record], names: Mapping[str, str], neighbours: int
) -> Record:
    """The summary of an evaluation; `names` are its experiment, variant, method, collection."""
    mark_neighbours(pairs, rows, neighbours)
    present = [group for group in GROUPS if members(rows, group)]
    return {
        **names,
        "shapes": len(rows),
        "normalization": NORMALIZATION,
        "groups": {group: group_figures(rows, pairs, group) for group in present},
        "curves": error_curves(pairs),
    }


def without_nan(value: Any) -> Any:
    """The same with null for what is no finite number, which JSON has no word for."""
    if isinstance(value, Mapping):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
