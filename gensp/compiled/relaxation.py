"""One vertex of a spherical triangulation at a time: insertion into a ring, and relaxation.

Positions are certified as they are made: a triangle counts as sound only where its determinant
exceeds the largest rounding error that it can have.
"""

import numpy as np
from numba import njit

from gensp.compiled.energies import energy_slopes, energy_value

CERTAIN = 1e-13  # determinant over the product of two sides, far above rounding
_HALVINGS = 30
_SUFFICIENT = 1e-4
_PLACES = 60  # tried between the middle of a kernel and its rim, each 0.7 times as far


@njit(cache=True)
def _gather(
    around: np.ndarray,
    size: int,
    i: int,
    x: np.ndarray,
    u: np.ndarray,
    scale: float,
    least: float,
    star: np.ndarray,
) -> None:
    """What the star of vertex i contributes, one row for every triangle (i, a, b).

    Columns: cot at i times |b − a|², cot at a, cot at b, 2 A scaled, weight, r_a × (r_b − r_a).
    """
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        fx, fy, fz = x[i, 0] - x[b, 0], x[i, 1] - x[b, 1], x[i, 2] - x[b, 2]
        gx, gy, gz = x[a, 0] - x[i, 0], x[a, 1] - x[i, 1], x[a, 2] - x[i, 2]
        nx, ny, nz = fy * gz - fz * gy, fz * gx - fx * gz, fx * gy - fy * gx
        twice = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
        sx, sy, sz = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
        star[k, 0] = -(fx * gx + fy * gy + fz * gz) / twice * (sx * sx + sy * sy + sz * sz)
        star[k, 1] = -(gx * ex + gy * ey + gz * ez) / twice
        star[k, 2] = -(ex * fx + ey * fy + ez * fz) / twice
        star[k, 3] = twice * scale
        star[k, 4] = max(0.5 * twice * scale, least)
        star[k, 5] = u[a, 1] * sz - u[a, 2] * sy
        star[k, 6] = u[a, 2] * sx - u[a, 0] * sz
        star[k, 7] = u[a, 0] * sy - u[a, 1] * sx


@njit(cache=True)
def _star_energy(
    p: np.ndarray,
    around: np.ndarray,
    size: int,
    u: np.ndarray,
    star: np.ndarray,
    energy: int,
    pull: float,
    goal: np.ndarray,
) -> float:
    """Energy of the star with its centre at p; infinite unless every triangle is surely sound."""
    total = pull * ((p[0] - goal[0]) ** 2 + (p[1] - goal[1]) ** 2 + (p[2] - goal[2]) ** 2)
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        gx, gy, gz = p[0] - u[a, 0], p[1] - u[a, 1], p[2] - u[a, 2]
        fx, fy, fz = p[0] - u[b, 0], p[1] - u[b, 1], p[2] - u[b, 2]
        determinant = gx * star[k, 5] + gy * star[k, 6] + gz * star[k, 7]
        near = gx * gx + gy * gy + gz * gz
        far = fx * fx + fy * fy + fz * fz
        rim = star[k, 5] ** 2 + star[k, 6] ** 2 + star[k, 7] ** 2
        if not determinant > CERTAIN * np.sqrt(max(near, far) * rim):
            return np.inf
        d = (star[k, 0] + star[k, 1] * far + star[k, 2] * near) / star[k, 3]
        total += star[k, 4] * energy_value(energy, d, determinant / star[k, 3])
    return total


@njit(cache=True)
def _newton_step(
    p: np.ndarray,
    around: np.ndarray,
    size: int,
    u: np.ndarray,
    star: np.ndarray,
    energy: int,
    pull: float,
    goal: np.ndarray,
) -> tuple[float, float, float, float]:
    """Tangential Newton step of the centre of a star, and the slope along it."""
    gx = -2 * pull * goal[0]
    gy = -2 * pull * goal[1]
    gz = -2 * pull * goal[2]
    # A frame of the tangent plane at p.
    if abs(p[2]) < 0.7:
        length = np.sqrt(p[0] * p[0] + p[1] * p[1])
        t0, t1, t2 = -p[1] / length, p[0] / length, 0.0
    else:
        length = np.sqrt(p[1] * p[1] + p[2] * p[2])
        t0, t1, t2 = 0.0, -p[2] / length, p[1] / length
    s0, s1, s2 = p[1] * t2 - p[2] * t1, p[2] * t0 - p[0] * t2, p[0] * t1 - p[1] * t0
    haa, hab, hbb = 0.0, 0.0, 0.0
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        ax, ay, az = p[0] - u[a, 0], p[1] - u[a, 1], p[2] - u[a, 2]
        bx, by, bz = p[0] - u[b, 0], p[1] - u[b, 1], p[2] - u[b, 2]
        nx, ny, nz = star[k, 5], star[k, 6], star[k, 7]
        twice = star[k, 3]
        d = (
            star[k, 0]
            + star[k, 1] * (bx * bx + by * by + bz * bz)
            + star[k, 2] * (ax * ax + ay * ay + az * az)
        ) / twice
        j = (ax * nx + ay * ny + az * nz) / twice
        fd, fj, fdd, fdj, fjj = energy_slopes(energy, d, j)
        w = star[k, 4]
        ca, cb = 2 * star[k, 2] / twice, 2 * star[k, 1] / twice
        dx, dy, dz = ca * ax + cb * bx, ca * ay + cb * by, ca * az + cb * bz
        jx, jy, jz = nx / twice, ny / twice, nz / twice
        gx += w * (fd * dx + fj * jx)
        gy += w * (fd * dy + fj * jy)
        gz += w * (fd * dz + fj * jz)
        da, db = dx * t0 + dy * t1 + dz * t2, dx * s0 + dy * s1 + dz * s2
        ja, jb = jx * t0 + jy * t1 + jz * t2, jx * s0 + jy * s1 + jz * s2
        flat = fd * (ca + cb)
        haa += w * (flat + fdd * da * da + 2 * fdj * da * ja + fjj * ja * ja)
        hab += w * (fdd * da * db + fdj * (da * jb + db * ja) + fjj * ja * jb)
        hbb += w * (flat + fdd * db * db + 2 * fdj * db * jb + fjj * jb * jb)
    # Following the sphere bends the step inwards.
    bend = gx * p[0] + gy * p[1] + gz * p[2]
    haa, hbb = haa - bend, hbb - bend
    ga, gb = gx * t0 + gy * t1 + gz * t2, gx * s0 + gy * s1 + gz * s2
    # Both eigenvalues are made positive: the step always descends.
    mean, half = 0.5 * (haa + hbb), 0.5 * (haa - hbb)
    radius = np.sqrt(half * half + hab * hab)
    floor = 1e-3 * (abs(mean) + radius) + 1e-300
    high, low = max(abs(mean + radius), floor), max(abs(mean - radius), floor)
    if radius > 0:
        vx, vy = hab, mean + radius - haa
        if abs(haa - mean + radius) > abs(vy):
            vx, vy = mean + radius - hbb, hab
        length = np.sqrt(vx * vx + vy * vy)
        if length > 0:
            vx, vy = vx / length, vy / length
        else:
            vx, vy = 1.0, 0.0
    else:
        vx, vy = 1.0, 0.0
    along, across = ga * vx + gb * vy, -ga * vy + gb * vx
    along, across = -along / high, -across / low
    qa, qb = along * vx - across * vy, along * vy + across * vx
    slope = ga * qa + gb * qb
    return qa * t0 + qb * s0, qa * t1 + qb * s1, qa * t2 + qb * s2, slope


@njit(cache=True)
def relax_vertex(
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
    steps: int,
    star: np.ndarray,
) -> float:
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
    _gather(around, size, i, x, u, scale, least, star)
    p, q = np.empty(3), np.empty(3)
    for c in range(3):
        p[c] = u[i, c]
    value = _star_energy(p, around, size, u, star, energy, pull, goal)
    if value == np.inf:
        return 0.0
    for _ in range(steps):
        dx, dy, dz, slope = _newton_step(p, around, size, u, star, energy, pull, goal)
        if not -slope > 1e-9 * value:
            break
        length, found = min(1.0, 0.5 / np.sqrt(dx * dx + dy * dy + dz * dz + 1e-300)), False
        for _ in range(_HALVINGS):
            q[0], q[1], q[2] = p[0] + length * dx, p[1] + length * dy, p[2] + length * dz
            norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
            q[0], q[1], q[2] = q[0] / norm, q[1] / norm, q[2] / norm
            reached = _star_energy(q, around, size, u, star, energy, pull, goal)
            if reached <= value + _SUFFICIENT * length * slope:
                found = True
                break
            length *= 0.5
        if not found:
            break
        gain, value = value - reached, reached
        p[0], p[1], p[2] = q[0], q[1], q[2]
        if gain < 1e-4 * value:
            break
    moved = np.sqrt((p[0] - u[i, 0]) ** 2 + (p[1] - u[i, 1]) ** 2 + (p[2] - u[i, 2]) ** 2)
    for c in range(3):
        u[i, c] = p[c]
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
    _gather(around, size, i, x, u, scale, least, star)
    best = _star_energy(goal, around, size, u, star, energy, pull, goal) if pull > 0 else np.inf
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
        value = _star_energy(place, around, size, u, star, energy, pull, goal)
        if value < best:
            best = value
            for c in range(3):
                u[i, c] = place[c]
        elif best < np.inf:
            break
        share *= 0.7
    return best < np.inf
