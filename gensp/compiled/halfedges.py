"""Half-edges of a closed triangulation, collapsed and split again in place.

Face f has the half-edges 3f, 3f + 1, 3f + 2; half-edge 3f + k leaves corner k. A collapse leaves
the half-edges of its two faces as they were, so that a split can put them back.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def following(h: int) -> int:
    """The next half-edge around the face of h."""
    return h + 1 if h % 3 < 2 else h - 2


@njit(cache=True)
def preceding(h: int) -> int:
    """The half-edge before h around its face."""
    return h - 1 if h % 3 > 0 else h + 2


@njit(cache=True)
def turned(h: int, twin: np.ndarray) -> int:
    """The next half-edge counter-clockwise around the origin of h."""
    return twin[preceding(h)]


@njit(cache=True)
def ring(h: int, origin: np.ndarray, twin: np.ndarray, out: np.ndarray) -> int:
    """Neighbours of the origin of h, counter-clockwise from the tip of h; gives their number."""
    size, at = 0, h
    while True:
        out[size] = origin[following(at)]
        size += 1
        at = turned(at, twin)
        if at == h:
            return size


@njit(cache=True)
def collapse(h: int, origin: np.ndarray, twin: np.ndarray, leaving: np.ndarray) -> None:
    """Move the origin v of h into its tip w; v and the two faces at h are gone."""
    t = twin[h]
    v, w = origin[h], origin[t]
    at = h
    while True:
        origin[at] = w
        at = turned(at, twin)
        if at == h:
            break
    origin[h] = v
    hn, hp, tn, tp = following(h), preceding(h), following(t), preceding(t)
    origin[tn] = v
    x, y, p, q = twin[hn], twin[hp], twin[tn], twin[tp]
    twin[x], twin[y], twin[p], twin[q] = y, x, q, p
    leaving[w], leaving[origin[x]], leaving[origin[p]] = y, x, p


@njit(cache=True)
def split(h: int, origin: np.ndarray, twin: np.ndarray, leaving: np.ndarray) -> None:
    """Undo the collapse of h, in the reverse order of the collapses."""
    t = twin[h]
    v = origin[h]
    hn, hp, tn, tp = following(h), preceding(h), following(t), preceding(t)
    twin[twin[hn]], twin[twin[hp]], twin[twin[tn]], twin[twin[tp]] = hn, hp, tn, tp
    at = h
    while True:
        origin[at] = v
        at = turned(at, twin)
        if at == h:
            break
    leaving[v], leaving[origin[t]] = h, t
