"""Vertices of many neighbours, whose stars are not walked whenever one neighbour changes.

Arguments, everywhere: `origin`, `twin`, `leaving` half-edges; `valence` (n,) numbers of
neighbours; `hub` (n,) whether a vertex has ever had more than `HUB`; `between` pairs of hubs that
are joined. Pairs are never taken out: an edge goes only together with one of its ends.
"""

import numpy as np
from numba import njit

from gensp.compiled.halfedges import following, turned

HUB = 64  # neighbours; what is done once a neighbour may cost the square of so many


@njit(cache=True)
def _pair(a: int, b: int, hub: np.ndarray) -> int:
    """The number that stands for two vertices, whatever their order."""
    return min(a, b) * len(hub) + max(a, b)


@njit(cache=True)
def _enlist(v, origin, twin, leaving, hub, between):
    """Make v a hub."""
    hub[v] = True
    at = leaving[v]
    while True:
        tip = origin[following(at)]
        if hub[tip]:
            between.add(_pair(v, tip, hub))
        at = turned(at, twin)
        if at == leaving[v]:
            return


@njit(cache=True)
def find_hubs(
    origin: np.ndarray, twin: np.ndarray, leaving: np.ndarray, between: set[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Valences, and which vertices are hubs; pairs of these are put into `between`."""
    valence = np.zeros(len(leaving), dtype=np.int64)
    hub = np.zeros(len(leaving), dtype=np.bool_)
    for h in range(len(origin)):
        valence[origin[h]] += 1
    for v in range(len(valence)):
        if valence[v] > HUB:
            _enlist(v, origin, twin, leaving, hub, between)
    return valence, hub


@njit(cache=True)
def joined(
    a: int,
    b: int,
    origin: np.ndarray,
    twin: np.ndarray,
    leaving: np.ndarray,
    hub: np.ndarray,
    between: set[int],
) -> bool:
    """Whether there is an edge between two vertices; it costs no more than the smaller star."""
    if hub[a] and hub[b]:
        return _pair(a, b, hub) in between
    if hub[a]:
        a, b = b, a
    at = leaving[a]
    while True:
        if origin[following(at)] == b:
            return True
        at = turned(at, twin)
        if at == leaving[a]:
            return False


@njit(cache=True)
def account(
    around: np.ndarray,
    size: int,
    origin: np.ndarray,
    twin: np.ndarray,
    leaving: np.ndarray,
    valence: np.ndarray,
    hub: np.ndarray,
    between: set[int],
) -> None:
    """Bring valences and hubs up to date: a vertex of ring around[:size] went into around[0]."""
    w = around[0]
    valence[w] += size - 4
    valence[around[1]] -= 1
    valence[around[size - 1]] -= 1
    if hub[w]:
        for k in range(2, size - 1):
            if hub[around[k]]:
                between.add(_pair(w, around[k], hub))
    elif valence[w] > HUB:
        _enlist(w, origin, twin, leaving, hub, between)
