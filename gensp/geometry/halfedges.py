"""Half-edges of a closed triangulation, collapsed and split again in place.

Face f has the half-edges 3f, 3f + 1, 3f + 2; half-edge 3f + k leaves corner k. A collapse leaves
the half-edges of its two faces as they were, so that a split can put them back.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Int
from numba import njit


@dataclass(frozen=True)
class HalfEdges:
    """Connectivity of a closed oriented triangulation with n vertices and h half-edges.

    Attributes
    ----------
    origin, twin
        Vertex that every half-edge leaves (h,), and the half-edge against it (h,).
    leaving
        One half-edge that leaves every vertex (n,).
    """

    origin: Int[np.ndarray, " h"]
    twin: Int[np.ndarray, " h"]
    leaving: Int[np.ndarray, " n"]

    @classmethod
    def of(cls, faces: Int[np.ndarray, "m 3"], count: int) -> Self:
        """Half-edges of a closed manifold with `count` vertices."""
        origin = np.ascontiguousarray(faces.reshape(-1))
        tip = np.ascontiguousarray(faces[:, [1, 2, 0]].reshape(-1))
        key, against = origin * count + tip, tip * count + origin
        order = np.argsort(key)
        twin = order[np.searchsorted(key, against, sorter=order)]
        leaving = np.empty(count, dtype=np.int64)
        leaving[origin] = np.arange(len(origin))
        return cls(origin.copy(), twin, leaving)


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
