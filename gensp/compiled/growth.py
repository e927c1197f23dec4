"""The growing map: vertices come back one by one and are relaxed with their rings.

Arguments, everywhere: `x`, `u` positions (n, 3) on the surface and on the sphere; `origin`,
`twin`, `leaving` half-edges; `moved` (n,) how far each vertex's ring has moved since it was last
relaxed; `scale`, `least` as in `relax_vertex`; `pulls`, `goals` weights (n,) and unit positions
(n, 3); `around`, `other`, `star` work space.
"""

from numba import njit

from gensp.compiled.halfedges import ring, split
from gensp.compiled.relaxation import insert_vertex, relax_vertex


@njit(cache=True)
def _relax_at(
    i, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals, around, star
):
    size = ring(leaving[i], origin, twin, around)
    away = relax_vertex(
        i, around, size, x, u, scale, least, energy, pulls[i], goals[i], steps, star
    )
    for k in range(size):
        moved[around[k]] += away
    return away


@njit(cache=True)
def insert(
    order, first, last, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals,
    around, other, star,
):  # fmt: skip
    """Insert order[first:last]; gives where it stopped: before `last` if one has no place."""
    for k in range(first, last):
        h = order[k]
        i = origin[h]
        split(h, origin, twin, leaving)
        size = ring(h, origin, twin, around)
        if not insert_vertex(
            i, around, size, x, u, scale, least, energy, pulls[i], goals[i], star
        ):
            return k
        moved[i] = 1.0
        for visit in range(2):
            steps = 4 - 3 * visit
            _relax_at(
                i, steps, x, u, origin, twin, leaving, moved, scale, least, energy, pulls, goals,
                other, star,
            )  # fmt: skip
            if visit == 0:
                for n in range(size):
                    _relax_at(
                        around[n], steps // 4, x, u, origin, twin, leaving, moved, scale, least,
                        energy, pulls, goals, other, star,
                    )  # fmt: skip
    return last


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
