"""Which shapes of a collection are worth comparing: near codes, and maps that a rotation matches.

Few shapes are compared with all; of many each with a number of candidates, so that nothing of the
size of all pairs is built.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.spatial.distance import cdist

from gensp.geometry.approximate_neighbours import approximate_neighbours
from gensp.geometry.rotation_registration import register_rotation
from gensp.geometry.spanning_tree import ALL_PAIRS

ALL_AGREEMENTS = 200  # shapes up to which every map is turned to every other
CANDIDATES = 64  # of each of more

Pairs = set[tuple[int, int]]


def nearest_pairs(codes: Float[np.ndarray, "k d"], count: int) -> Pairs:
    """Unordered pairs of every code with its `count` nearest others.

    Above `ALL_PAIRS` codes these are nearly the nearest, see `approximate_neighbours`.
    """
    count = min(count, len(codes) - 1)
    if len(codes) <= ALL_PAIRS:
        return _chosen(cdist(codes, codes), count)
    near = approximate_neighbours(codes, count)
    ends = np.stack([np.repeat(np.arange(len(codes)), count), near.ravel()])
    low, high = np.sort(ends, axis=0)
    found = np.divmod(np.unique(low * len(codes) + high), len(codes))
    return set(zip(*(end.tolist() for end in found), strict=True))


def star_pairs(codes: Float[np.ndarray, "k d"]) -> Pairs:
    """Pairs of every code with the one that is nearest to all; of many, nearest to their mean."""
    if len(codes) <= ALL_PAIRS:
        centre = int(cdist(codes, codes).sum(axis=1).argmin())
    else:
        centre = int(np.linalg.norm(codes - codes.mean(axis=0), axis=1).argmin())
    return {(min(centre, k), max(centre, k)) for k in range(len(codes)) if k != centre}


def agreeing_pairs(signals: Sequence[Complex[np.ndarray, "l o"]], count: int) -> Pairs:
    """Unordered pairs of every map with the `count` that agree best with it after a rotation.

    Parameters
    ----------
    signals
        Of `density_signal`, one of every map.
    """
    candidates = rotation_candidates(signals)
    found = {pair: _agreement(signals, *pair) for pair in sorted(candidates)}
    partners: list[list[tuple[float, int]]] = [[] for _ in signals]
    for (i, j), agreement in found.items():
        partners[i].append((-agreement, j))
        partners[j].append((-agreement, i))
    best = [sorted(row)[:count] for row in partners]
    return {(min(i, j), max(i, j)) for i, row in enumerate(best) for _, j in row}


def _agreement(signals: Sequence[Complex[np.ndarray, "l o"]], i: int, j: int) -> float:
    return register_rotation(signals[j], signals[i], candidates=1)[0].correlation


def rotation_candidates(signals: Sequence[Complex[np.ndarray, "l o"]]) -> Pairs:
    """Pairs whose maps may agree after a rotation: all of few, the `CANDIDATES` likeliest of many.

    A rotation mixes the coefficients of one degree. By Cauchy and Schwarz no rotation correlates
    two signals more than the inner product of their norms by degree, each normalised; so the
    nearest by these bound vectors are the likeliest.
    """
    count = len(signals)
    if count <= ALL_AGREEMENTS:
        return {(i, j) for j in range(count) for i in range(j)}
    return nearest_pairs(degree_norms(signals), CANDIDATES)


def degree_norms(signals: Sequence[Complex[np.ndarray, "l o"]]) -> Float[np.ndarray, "k l"]:
    """Norm of the coefficients of every degree, as unit vectors; no rotation changes them."""
    norms = np.stack([np.linalg.norm(signal, axis=1) for signal in signals])
    length = np.linalg.norm(norms, axis=1, keepdims=True)
    unit: np.ndarray = norms / np.where(length > 0, length, 1)
    return unit


def _chosen(distance: Float[np.ndarray, "k k"], count: int) -> Pairs:
    away = distance + np.where(np.eye(len(distance), dtype=bool), np.inf, 0)
    near: Int[np.ndarray, "k c"] = np.argsort(away, axis=1, kind="stable")[:, :count]
    return {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(near) for j in row}
