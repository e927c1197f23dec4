"""How well the reliability of a match tells where it is wrong.

    python benchmarks/trust.py data/quadrupeds RUN/parameterize [RUN/parameterize ...]

Every template's first shape with its others, vertex by vertex against the dense ground truth;
learnt maps as they are, others aligned first, as in `gensp match`. Two reliabilities: 1/σ of the
map from shape to shape, which is written, and the product of 1/σ of both maps to the sphere.
Columns: the error over √area, and for each reliability its rank correlation with the error and the
chance that of two points, one off by more than 0.1 and one not, it trusts the right one more
(0.5: a guess).
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import mannwhitneyu, spearmanr

from gensp.data.ground_truth import GroundTruth, common_points
from gensp.data.shapes import ShapeCollection
from gensp.geometry.implied import correspondence_error
from gensp.geometry.matching import aligning_rotation, matching, nearness_to_isometry
from gensp.geometry.spherical_map import load_map

FAR = 0.1  # an error that is a wrong match


def pairs(collection: ShapeCollection) -> Iterator[tuple[str, str]]:
    """The first shape of each template with the others of it."""
    groups = defaultdict(list)
    for id in collection.ids():
        truth = collection.ground_truth(id)
        if truth is not None:
            groups[truth.template].append(id)
    for first, *others in groups.values():
        yield from ((first, other) for other in others)


def judged(folder: Path, truths: dict[str, GroundTruth], pair: tuple[str, str]) -> np.ndarray:
    """Error, reliability of the match and product of both maps' at the common points (3, k)."""
    a, b = (load_map(folder / "maps" / f"{id}.npz") for id in pair)
    rows, others = common_points(*(truths[id] for id in pair))
    at, there = truths[pair[0]].at.take(rows), truths[pair[1]].at.take(others)
    rotation = None if (folder / "predictions").is_dir() else aligning_rotation(a, b)
    found = matching(a, b, rotation)
    own, other = (nearness_to_isometry(map, map.sphere) for map in (a, b))
    product = own * found.at.on(other[:, None], b.faces)[:, 0]
    values = np.stack([found.reliability, product], axis=1)
    error = correspondence_error(a, b, at, there, rotation)
    return np.vstack([error, at.on(values, a.faces).T])


def row(name: str, table: np.ndarray) -> str:
    """A line of the table."""
    error, *reliabilities = table
    wrong = error > FAR
    figures = []
    for value in reliabilities:
        more = mannwhitneyu(value[~wrong], value[wrong]).statistic
        figures.append(f"{spearmanr(value, error).statistic:.2f}")
        figures.append(f"{more / (wrong.sum() * (~wrong).sum()):.3f}")
    return f"| {name} | {error.mean():.4f} | {wrong.mean():.3f} | {' | '.join(figures)} |\n"


def main() -> None:
    """Print a row for every folder of maps, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("collection", type=Path)
    parser.add_argument("folders", nargs="+", type=Path)
    chosen = parser.parse_args()
    collection = ShapeCollection.from_folder(chosen.collection)
    truths = {id: collection.ground_truth(id) for id in collection.ids()}
    sys.stdout.write(
        f"| maps | error | above {FAR} | of the match: correlation | chance | of both maps: "
        "correlation | chance |\n|---|--:|--:|--:|--:|--:|--:|\n"
    )
    tables = {}
    for folder in chosen.folders:
        name = folder.resolve().parent.name
        found = [judged(folder, truths, pair) for pair in pairs(collection)]
        tables[name] = np.concatenate(found, axis=1)
        sys.stdout.write(row(name, tables[name]))
    sys.stdout.write(row("all", np.concatenate(list(tables.values()), axis=1)))


if __name__ == "__main__":
    main()
