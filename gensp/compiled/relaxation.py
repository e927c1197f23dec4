"""One vertex of a spherical triangulation at a time: insertion into a ring, and relaxation."""

import numpy as np
from numba import njit

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
def _normals(around: np.ndarray, size: int, u: np.ndarray, star: np.ndarray) -> bool:
    """Unit normals of the great circles along the ring, into the first columns of `star`."""
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        sx, sy, sz = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
        nx = u[a, 1] * sz - u[a, 2] * sy
        ny = u[a, 2] * sx - u[a, 0] * sz
        nz = u[a, 0] * sy - u[a, 1] * sx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0:
            return False
        star[k, 0], star[k, 1], star[k, 2] = nx / length, ny / length, nz / length
    return True


@njit(cache=True)
def _sees_all(
    cx: float, cy: float, cz: float, k: int, n: int, size: int, star: np.ndarray
) -> bool:
    """Whether (cx, cy, cz) is inside of all great circles but k and n, where they meet."""
    for m in range(size):
        above = star[m, 0] * cx + star[m, 1] * cy + star[m, 2] * cz
        if above < -1e-12 and m != k and m != n:
            return False
    return True


@njit(cache=True)
def _kernel_centre(
    around: np.ndarray, size: int, u: np.ndarray, star: np.ndarray, out: np.ndarray
) -> bool:
    """Mean direction of the kernel's corners: the points that see the whole spherical polygon."""
    out[0] = out[1] = out[2] = 0.0
    if not _normals(around, size, u, star):
        return False
    for k in range(size):
        for n in range(k + 1, size):
            cx = star[k, 1] * star[n, 2] - star[k, 2] * star[n, 1]
            cy = star[k, 2] * star[n, 0] - star[k, 0] * star[n, 2]
            cz = star[k, 0] * star[n, 1] - star[k, 1] * star[n, 0]
            length = np.sqrt(cx * cx + cy * cy + cz * cz)
            if length < 1e-12:
                continue
            for sign in range(-1, 2, 2):
                sx, sy, sz = sign * cx / length, sign * cy / length, sign * cz / length
                if _sees_all(sx, sy, sz, k, n, size, star):
                    out[0], out[1], out[2] = out[0] + sx, out[1] + sy, out[2] + sz
    length = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if length < 1e-12:
        return False
    for c in range(3):
        out[c] /= length
    return True


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
    seen = _kernel_centre(around, size, u, star, centre)
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
