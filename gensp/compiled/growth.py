"""The growing map: vertices come back one by one and are relaxed with their rings.

Arguments, everywhere: `x`, `u` positions (n, 3) on the surface and on the sphere; `origin`,
`twin`, `leaving` half-edges; `moved` (n,) how far each vertex's ring has moved since it was last
relaxed; `scale`, `least` as in `relax_vertex`; `pulls`, `goals` weights (n,) and unit positions
(n, 3); `around`, `other`, `star` work space.
"""

import numpy as np
from numba import njit

from gensp.compiled.halfedges import ring, split
from gensp.compiled.hubs import HUB
from gensp.compiled.relaxation import insert_vertex, relax_vertex
from gensp.compiled.stars import gather, star_distortion


@njit(cache=True)
def _relax_at(
    i, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals, around, star
):
    """Relax vertex i and tell its neighbours; gives their number."""
    size = ring(leaving[i], origin, twin, around)
    away = relax_vertex(
        i, around, size, x, u, scale, least, energy, pulls[i], goals[i], steps, star
    )
    for k in range(size):
        moved[around[k]] += away
    return size


@njit(cache=True)
def _distortion_at(i, x, u, origin, twin, leaving, scale, least, around, star):
    """Largest σ_t of the triangles at vertex i."""
    size = ring(leaving[i], origin, twin, around)
    gather(around, size, i, x, u, scale, least, star)
    return star_distortion(u[i], around, size, u, star)


@njit(cache=True)
def insert(
    order, first, last, fewest, bound, x, u, origin, twin, leaving, moved, scale, least, energy,
    pulls, goals, waits, around, other, star,
):  # fmt: skip
    """Insert order[first:last]; gives where it ended, and False if the vertex there has no place.

    From `fewest` on it ends with the first vertex that has a triangle of σ_t > `bound`. `waits`
    (n,) is how many new neighbours a vertex lets pass before it is relaxed again: the more
    neighbours it has the more, so that a fan is not walked with every one of its triangles.
    """
    for k in range(first, last):
        h = order[k]
        i = origin[h]
        split(h, origin, twin, leaving)
        size = ring(h, origin, twin, around)
        if not insert_vertex(
            i, around, size, x, u, scale, least, energy, pulls[i], goals[i], star
        ):
            return k, False
        moved[i] = 1.0
        for visit in range(2):
            steps = 4 - 3 * visit
            _relax_at(
                i, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals,
                other, star,
            )  # fmt: skip
            if visit == 0:
                for n in range(size):
                    near = around[n]
                    waits[near] -= 1
                    if waits[near] < 0:
                        waits[near] = _relax_at(
                            near, steps // 4, x, u, origin, twin, leaving, moved, scale, least,
                            energy, pulls, goals, other, star,
                        ) // HUB  # fmt: skip
        if k + 1 < fewest or bound == np.inf:
            continue
        if _distortion_at(i, x, u, origin, twin, leaving, scale, least, other, star) > bound:
            return k + 1, True
    return last, True


@njit(cache=True)
def sweep(
    active, still, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals,
    around, other, star,
):  # fmt: skip
    """Relax every vertex whose ring has moved since it was last visited."""
    for i in active:
        if moved[i] > still:
            moved[i] = 0.0
            _relax_at(
                i, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals,
                around, star,
            )  # fmt: skip


@njit(cache=True)
def largest_distortion(active, x, u, origin, twin, leaving, scale, least, around, star):
    """Largest σ_t of all triangles of the map so far."""
    worst = 1.0
    for i in active:
        found = _distortion_at(i, x, u, origin, twin, leaving, scale, least, around, star)
        worst = max(worst, found)
    return worst
