"""How near approximate neighbours are to the nearest ones, and what they cost; see `costs.py`.

Codes of six kinds: normal numbers in 64 and in 256 dimensions, which have no near neighbours; a
smooth surface of five dimensions within as many; and 64 clusters of eight degrees of freedom each
and a little noise. Recall is the share of the true 16 nearest that were found, of 500 codes; the
weight is that of the minimum tree over that of all pairs.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gensp.files import write_json
from gensp.geometry import spanning_tree as trees
from gensp.geometry.approximate_neighbours import approximate_neighbours
from gensp.geometry.spanning_tree import spanning_tree

Row = dict[str, Any]
ASKED = 500
NEAREST = 16


def normal(count: int, width: int) -> np.ndarray:
    """Independent normal numbers."""
    return np.random.default_rng(0).standard_normal((count, width))


def surface(count: int, width: int) -> np.ndarray:
    """A smooth map of the unit cube of five dimensions."""
    rng = np.random.default_rng(0)
    slopes, phases = 2 * rng.standard_normal((5, width)), 2 * np.pi * rng.random(width)
    places: np.ndarray = np.sin(rng.random((count, 5)) @ slopes + phases)
    return places


def clusters(count: int, width: int) -> np.ndarray:
    """Clusters far apart, each within eight dimensions but for some noise."""
    rng = np.random.default_rng(0)
    middles, spread = 3 * rng.standard_normal((64, width)), rng.standard_normal((8, width))
    within = 0.3 * rng.standard_normal((count, 8)) @ spread
    noise = 0.02 * rng.standard_normal((count, width))
    found: np.ndarray = middles[rng.integers(64, size=count)] + within + noise
    return found


def squares(codes: np.ndarray, some: np.ndarray) -> np.ndarray:
    """Squared distances of some codes to all."""
    lengths = np.square(codes).sum(axis=1)
    found: np.ndarray = codes[some] @ codes.T
    found *= -2
    found += lengths
    found += lengths[some, None]
    return found


def recall(codes: np.ndarray, near: np.ndarray) -> float:
    """Share of the true nearest that are among the neighbours found."""
    asked = np.random.default_rng(1).choice(len(codes), ASKED, replace=False)
    gaps = squares(codes, asked)
    gaps[np.arange(ASKED), asked] = np.inf
    true = np.argpartition(gaps, NEAREST, axis=1)[:, :NEAREST]
    return float(np.mean([np.isin(a, b).mean() for a, b in zip(true, near[asked], strict=True)]))


def least_weight(codes: np.ndarray) -> float:
    """Weight of the minimum tree of all pairs, one code after the other (Prim)."""
    gaps = squares(codes, np.arange(len(codes)))
    nearest, total = gaps[0].copy(), 0.0
    nearest[0] = np.inf
    for _ in range(len(codes) - 1):
        here = int(nearest.argmin())
        total += float(np.sqrt(max(nearest[here], 0)))
        # What has come in stays infinite.
        nearest = np.where(np.isinf(nearest), np.inf, np.minimum(nearest, gaps[here]))
        nearest[here] = np.inf
    return total


class Kept:
    """Neighbours as trees ask for them, with what they took."""

    def __call__(self, codes: np.ndarray, count: int) -> np.ndarray:
        """Find them."""
        began = time.process_time()
        self.near = approximate_neighbours(codes, count)
        self.seconds = time.process_time() - began
        return self.near


def figures(codes: np.ndarray) -> Row:
    """Processor seconds of a tree and of the neighbours within it, with the recall and weight."""
    trees.approximate_neighbours = kept = Kept()
    began = time.process_time()
    tree = spanning_tree(codes, 0)
    seconds = time.process_time() - began
    weight = float(tree.weight.sum())
    found = {"codes": len(codes), "seconds": kept.seconds, "tree_seconds": seconds}
    return {**found, "recall": recall(codes, kept.near), "weight": weight}


def neighbours(out: Path, counts: Sequence[int], kinds: Sequence[str]) -> list[Row]:
    """Write neighbours.json: seconds, recall and weight of every kind and number of codes."""
    out.mkdir(parents=True, exist_ok=True)
    spanning_tree(KINDS["normal"](2100, 64), 0)  # loops are compiled
    rows: list[Row] = []
    for kind, width in ((kind, width) for kind in kinds for width in (64, 256)):
        for count in counts:
            codes = KINDS[kind](count, width)
            row = {"kind": f"{kind}, {width}", **figures(codes)}
            row["least"] = least_weight(codes) if count == min(counts) else None
            rows.append(row)
            write_json(out / "neighbours.json", rows)
    return rows


KINDS: dict[str, Callable[[int, int], np.ndarray]] = {
    "surface": surface,
    "clusters": clusters,
    "normal": normal,
}
