"""What Möbius centring and reflection before the rotation do to the consistency of maps.

    python benchmarks/centring.py data/heads RUN/parameterize [RUN/parameterize ...]

Maps as they are, or each centred first (Baden, Crane & Kazhdan 2018), then turned to each other by
the rotation that is found without ground truth, or by that or a reflection. Columns: the error
over √area after it, mean over pairs with dense ground truth; how many pairs took a reflection;
mean σ of the maps.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from gensp.data.ground_truth import GroundTruth, common_points
from gensp.data.shapes import ShapeCollection
from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import moebius_center
from gensp.geometry.implied import MatchedMaps
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.tables import markdown_table


def centred(map: SphericalMap) -> SphericalMap:
    """The map composed with the inversion that centres it, if there is one."""
    try:
        sphere = moebius_center(map.sphere, map.faces, map.mesh.face_areas)
    except NotEmbeddable:
        return map
    return replace(map, sphere=sphere)


def row(
    maps: Mapping[str, SphericalMap], truths: Mapping[str, GroundTruth], reflection: bool
) -> list[str]:
    """Error after registration, pairs that took a reflection, mean σ."""
    signals = {
        id: density_signal(map.sphere, map.faces, map.mesh.face_areas) for id, map in maps.items()
    }
    errors, reflected = [], 0
    for a, b in combinations(maps, 2):
        rows, others = common_points(truths[a], truths[b])
        if len(rows) == 0:
            continue
        (best,) = register_rotation(signals[a], signals[b], reflection=reflection, candidates=1)
        at = truths[a].at.take(rows), truths[b].at.take(others)
        errors.append(MatchedMaps(maps[a], maps[b], *at).error(best.rotation))
        reflected += bool(np.linalg.det(best.rotation) < 0)
    sigma = np.mean([map.distortion().mean for map in maps.values()])
    return [f"{np.mean(errors):.4f}", f"{reflected} of {len(errors)}", f"{sigma:.3f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("collection", type=Path)
    parser.add_argument("runs", type=Path, nargs="+", help="folders of stage parameterize")
    parser.add_argument("--every", type=int, default=1, help="take every so manieth shape")
    options = parser.parse_args()
    collection = ShapeCollection.from_folder(options.collection)
    found = {id: collection.ground_truth(id) for id in collection.ids()[:: options.every]}
    truths = {id: truth for id, truth in found.items() if truth is not None}
    table = []
    for run in options.runs:
        plain = {id: load_map(run / "maps" / f"{id}.npz") for id in truths}
        moved = {id: centred(map) for id, map in plain.items()}
        for words, maps in (("as it is", plain), ("centred", moved)):
            for reflection in (False, True):
                turn = "rotation or reflection" if reflection else "rotation"
                table.append([run.parent.name, words, turn, *row(maps, truths, reflection)])
    header = ["method", "maps", "then", "error", "reflected", "mean σ"]
    sys.stdout.write(markdown_table(header, table))


if __name__ == "__main__":
    main()
