"""One vertex of a spherical triangulation at a time: insertion into a ring, and relaxation."""

import numpy as np
from numba import njit

from gensp.compiled.kernels import kernel_centre
from gensp.compiled.stars import gather, newton_step, star_energy

_HALVINGS = 30
_SUFFICIENT = 1e-4
_PLACES = 60  # tried between the middle of a kernel and its rim, each 0.7 times as far


@njit(cache=True)
def _line_search(
    p, q, dx, dy, dz, slope, value, around, size, u, star, energy, pull, goal
):  # fmt: skip
    """Put the longest halved step from p that descends enough into q; its energy, inf if none."""
    length = min(1.0, 0.5 / np.sqrt(dx * dx + dy * dy + dz * dz + 1e-300))
    for _ in range(_HALVINGS):
        q[0], q[1], q[2] = p[0] + length * dx, p[1] + length * dy, p[2] + length * dz
        norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
        q[0], q[1], q[2] = q[0] / norm, q[1] / norm, q[2] / norm
        reached = star_energy(q, around, size, u, star, energy, pull, goal)
        if reached <= value + _SUFFICIENT * length * slope:
            return reached
        length *= 0.5
    return np.inf


@njit(cache=True)
def relax_vertex(
    i, around, size, x, u, scale, least, energy, pull, goal, steps, star
):  # fmt: skip
    """Move vertex i to a lower energy of its star by safeguarded Newton; gives the distance moved.

    Parameters
    ----------
    around, size
        Neighbours of i, counter-clockwise.
    x, u
        Positions (n, 3) on the surface and on the sphere; u[i] is changed.
    scale, least
        Factor of the surface's areas, and smallest weight of a triangle.
    pull, goal
        Weight of ‖u_i − goal‖².
    star
        Work space (size, 8).
    """
    gather(around, size, i, x, u, scale, least, star)
    p, q = np.empty(3), np.empty(3)
    p[0], p[1], p[2] = u[i, 0], u[i, 1], u[i, 2]
    value = star_energy(p, around, size, u, star, energy, pull, goal)
    for _ in range(steps if value < np.inf else 0):
        dx, dy, dz, slope = newton_step(p, around, size, u, star, energy, pull, goal)
        if not -slope > 1e-9 * value:
            break
        reached = _line_search(
            p, q, dx, dy, dz, slope, value, around, size, u, star, energy, pull, goal
        )
        if reached == np.inf:
            break
        gain, value = value - reached, reached
        p[0], p[1], p[2] = q[0], q[1], q[2]
        if gain < 1e-4 * value:
            break
    moved = np.sqrt((p[0] - u[i, 0]) ** 2 + (p[1] - u[i, 1]) ** 2 + (p[2] - u[i, 2]) ** 2)
    u[i, 0], u[i, 1], u[i, 2] = p[0], p[1], p[2]
    return moved


@njit(cache=True)
def insert_vertex(
    i: int,
    around: np.ndarray,
    size: int,
    x: np.ndarray,
    u: np.ndarray,
    scale: float,
    least: float,
    energy: int,
    pull: float,
    goal: np.ndarray,
    star: np.ndarray,
) -> bool:
    """Put vertex i where it sees its whole ring, at the best of several places; False: nowhere.

    Tried are the goal, the middle of the ring's kernel, and points between it and around[0], the
    vertex that i was collapsed into.
    """
    centre, place = np.empty(3), np.empty(3)
    seen = kernel_centre(around, size, u, star, centre)
    gather(around, size, i, x, u, scale, least, star)
    best = star_energy(goal, around, size, u, star, energy, pull, goal) if pull > 0 else np.inf
    if best < np.inf:
        for c in range(3):
            u[i, c] = goal[c]
    share = 1.0
    for _ in range(_PLACES if seen else 0):
        length = 0.0
        for c in range(3):
            place[c] = share * centre[c] + (1 - share) * u[around[0], c]
            length += place[c] * place[c]
        for c in range(3):
            place[c] /= np.sqrt(length)
        value = star_energy(place, around, size, u, star, energy, pull, goal)
        if value < best:
            best = value
            for c in range(3):
                u[i, c] = place[c]
        elif best < np.inf:
            break
        share *= 0.7
    return best < np.inf
