"""Consistency against distortion over the pull γ, from the predictions of a finished run.

python benchmarks/pull.py runs/quickstart/full/parameterize data/heads --out docs/pull_heads

Every prediction of the run is refined with refine=certify at several γ, with and without Bregman
iterations; `--out` gets a table (csv) and a picture (png). Error: implied correspondence over
√area, mean over the pairs with dense ground truth, without rotation; that of the predictions goes
through the generated surfaces, since folded maps have no inverse
(`gensp.geometry.consistency.prediction_error`).
"""

import argparse
import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import TypeVar

import numpy as np

from gensp.data.ground_truth import common_points
from gensp.data.shapes import ShapeCollection
from gensp.files import atomic_path
from gensp.geometry.consistency import GeneratedShape, prediction_error
from gensp.geometry.distance import closest_point
from gensp.geometry.implied import correspondence_error
from gensp.geometry.mesh import normalize
from gensp.geometry.points import SurfacePoints
from gensp.geometry.refine import reliability
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.refinement import CertifiedRefinement
from gensp.pictures.curves import figure, save_figure
from gensp.tasks.evaluate import predicted_surface, prediction

GAMMAS = (1.0, 10.0, 30.0, 100.0, 300.0)
Pair = tuple[str, str, SurfacePoints, SurfacePoints]
T = TypeVar("T")


def maps(
    run: Path, collection: ShapeCollection, gamma: float, bregman: int
) -> dict[str, SphericalMap]:
    """The maps of all predicted shapes at one γ."""
    refine = CertifiedRefinement(pull=gamma, bregman=bregman)
    found = {}
    for id in collection.ids():
        arrays = prediction(run, id)
        if arrays:
            mesh = normalize(collection.mesh(id))
            start, surface = arrays["predicted"], predicted_surface(run, id, "fitted")
            away = closest_point(mesh.vertices, surface).distance
            found[id] = refine(mesh, start, start, reliability(start, mesh.faces, away))
    return found


def pairs(ids: Sequence[str], collection: ShapeCollection) -> Iterator[Pair]:
    """Every pair with dense ground truth, and its points on both shapes."""
    for first, second in combinations(ids, 2):
        truths = collection.ground_truth(first), collection.ground_truth(second)
        if truths[0] is None or truths[1] is None:
            continue
        rows, others = common_points(*truths)
        if len(rows):
            yield first, second, truths[0].take(rows).at, truths[1].take(others).at


def mean_error(
    found: Mapping[str, T], measure: Callable[..., np.ndarray], collection: ShapeCollection
) -> float:
    """Mean over the pairs of the error in both directions."""
    errors = [
        (
            measure(found[a], found[b], at_a, at_b).mean()
            + measure(found[b], found[a], at_b, at_a).mean()
        )
        / 2
        for a, b, at_a, at_b in pairs(list(found), collection)
    ]
    return float(np.mean(errors))


def unrefined(run: Path, collection: ShapeCollection) -> float:
    """Error of the predictions, between the surfaces that maps are read off."""
    images = {id: predicted_surface(run, id, "fitted") for id in collection.ids()}
    shapes = {
        id: GeneratedShape(normalize(collection.mesh(id)), image)
        for id, image in images.items()
        if image is not None
    }
    return mean_error(shapes, prediction_error, collection)


def line(
    run: Path, collection: ShapeCollection, gamma: float, bregman: int, prediction: float
) -> dict:
    """One line of the table; `prediction` is the error before refinement."""
    found = maps(run, collection, gamma, bregman)
    distortions = [map.distortion() for map in found.values()]
    rungs = [map.diagnostics["rung"] for map in found.values()]
    return {
        "gamma": gamma,
        "bregman": bregman,
        "shapes": len(found),
        "error": mean_error(found, correspondence_error, collection),
        "error_prediction": prediction,
        "sigma_mean": float(np.mean([d.mean for d in distortions])),
        "sigma_max": float(np.max([d.max for d in distortions])),
        "bad_faces": sum(int(map.bad_faces().sum()) for map in found.values()),
        "not_bijective": sum(not map.certify() for map in found.values()),
        **{f"rung_{name}": rungs.count(name) for name in ("prediction", "spread", "untangled")},
        "rung_hierarchical": rungs.count("hierarchical"),
        "seconds": float(np.mean([map.diagnostics["seconds"] for map in found.values()])),
    }


def draw(lines: list[dict], path: Path, title: str) -> None:
    """Mean σ against error, one point for every γ, one curve for every number of iterations."""
    drawing = figure(6, 4)
    panel = drawing.subplots()
    for bregman in sorted({row["bregman"] for row in lines}):
        rows = [row for row in lines if row["bregman"] == bregman]
        errors, sigmas = ([row[key] for row in rows] for key in ("error", "sigma_mean"))
        panel.plot(errors, sigmas, "o-", label=f"Bregman iterations: {bregman}")
    for row in lines:
        panel.annotate(
            f"γ = {row['gamma']:g}", (row["error"], row["sigma_mean"]), (6, 4),
            textcoords="offset points",
        )  # fmt: skip
    panel.legend()
    panel.margins(0.12)
    panel.set(xlabel="error / √area, no rotation", ylabel="mean σ", title=title)
    save_figure(drawing, path)


def write(lines: list[dict], path: Path) -> None:
    """The table, whole or not at all."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
        table = csv.DictWriter(file, list(lines[0]))
        table.writeheader()
        table.writerows(lines)


def main() -> None:
    """Read the command line, write the table after every line, and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path, help="folder of a finished parameterize stage")
    parser.add_argument("collection", type=Path, help="folder of its meshes")
    parser.add_argument("--out", type=Path, required=True, help="path without suffix")
    parser.add_argument(
        "--gammas", type=float, nargs="*", default=GAMMAS, help="none: only the predictions"
    )
    parser.add_argument("--bregman", type=int, nargs="+", default=(0, 1), help="iterations")
    words = parser.parse_args()
    collection = ShapeCollection.from_folder(words.collection)
    prediction = unrefined(words.run, collection)
    print(f"error of the predictions: {prediction:.5f}", flush=True)  # noqa: T201
    lines: list[dict] = []
    for bregman, gamma in product(words.bregman, words.gammas):
        lines.append(line(words.run, collection, gamma, bregman, prediction))
        print(lines[-1], flush=True)  # noqa: T201
        write(lines, words.out.with_suffix(".csv"))
    if lines:
        draw(lines, words.out.with_suffix(".png"), collection.name)


if __name__ == "__main__":
    main()
