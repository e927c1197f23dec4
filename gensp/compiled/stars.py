"""The star of one vertex of a spherical triangulation: its energy and Newton step.

Positions are certified as they are made: a triangle counts as sound only where its determinant
exceeds the largest rounding error that it can have.
"""

import numpy as np
from numba import njit

from gensp.compiled.energies import energy_slopes, energy_value

CERTAIN = 1e-13  # determinant over the product of two sides, far above rounding


@njit(cache=True)
def gather(
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
def _measured(
    p: np.ndarray, a: int, b: int, k: int, u: np.ndarray, star: np.ndarray
) -> tuple[float, float, float]:
    """det(p, u_a, u_b) of the triangle of row k, and the squares |p − u_a|² and |p − u_b|²."""
    gx, gy, gz = p[0] - u[a, 0], p[1] - u[a, 1], p[2] - u[a, 2]
    fx, fy, fz = p[0] - u[b, 0], p[1] - u[b, 1], p[2] - u[b, 2]
    determinant = gx * star[k, 5] + gy * star[k, 6] + gz * star[k, 7]
    return determinant, gx * gx + gy * gy + gz * gz, fx * fx + fy * fy + fz * fz


@njit(cache=True)
def star_energy(
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
        determinant, near, far = _measured(p, a, b, k, u, star)
        rim = star[k, 5] ** 2 + star[k, 6] ** 2 + star[k, 7] ** 2
        if not determinant > CERTAIN * np.sqrt(max(near, far) * rim):
            return np.inf
        d = (star[k, 0] + star[k, 1] * far + star[k, 2] * near) / star[k, 3]
        total += star[k, 4] * energy_value(energy, d, determinant / star[k, 3])
    return total


@njit(cache=True)
def star_distortion(
    p: np.ndarray, around: np.ndarray, size: int, u: np.ndarray, star: np.ndarray
) -> float:
    """Largest σ_t = max(σ₁, 1/σ₂) of the sound triangles of a star with its centre at p.

    σ₁σ₂ is the energies' determinant: that of the chords times the distance of their plane, so
    that coarse maps look more distorted than they are.
    """
    worst = 1.0
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        determinant, near, far = _measured(p, a, b, k, u, star)
        j = determinant / star[k, 3]
        d = (star[k, 0] + star[k, 1] * far + star[k, 2] * near) / star[k, 3]
        longest = np.sqrt(0.5 * (d + np.sqrt(max(d * d - 4 * j * j, 0.0))))
        worst = max(worst, longest, longest / j)
    return worst


@njit(cache=True)
def _frame(p: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """Two orthonormal tangents at p."""
    if abs(p[2]) < 0.7:
        length = np.sqrt(p[0] * p[0] + p[1] * p[1])
        t0, t1, t2 = -p[1] / length, p[0] / length, 0.0
    else:
        length = np.sqrt(p[1] * p[1] + p[2] * p[2])
        t0, t1, t2 = 0.0, -p[2] / length, p[1] / length
    return t0, t1, t2, p[1] * t2 - p[2] * t1, p[2] * t0 - p[0] * t2, p[0] * t1 - p[1] * t0


@njit(cache=True)
def _derivatives(
    p, around, size, u, star, energy, pull, goal, t0, t1, t2, s0, s1, s2
):  # fmt: skip
    """Gradient (a, b) and Hessian (aa, ab, bb) of the star's energy in the tangents at p."""
    gx, gy, gz = -2 * pull * goal[0], -2 * pull * goal[1], -2 * pull * goal[2]
    haa, hab, hbb = 0.0, 0.0, 0.0
    for k in range(size):
        a, b = around[k], around[(k + 1) % size]
        ax, ay, az = p[0] - u[a, 0], p[1] - u[a, 1], p[2] - u[a, 2]
        bx, by, bz = p[0] - u[b, 0], p[1] - u[b, 1], p[2] - u[b, 2]
        twice, w = star[k, 3], star[k, 4]
        far, near = bx * bx + by * by + bz * bz, ax * ax + ay * ay + az * az
        d = (star[k, 0] + star[k, 1] * far + star[k, 2] * near) / twice
        jx, jy, jz = star[k, 5] / twice, star[k, 6] / twice, star[k, 7] / twice
        fd, fj, fdd, fdj, fjj = energy_slopes(energy, d, ax * jx + ay * jy + az * jz)
        ca, cb = 2 * star[k, 2] / twice, 2 * star[k, 1] / twice
        dx, dy, dz = ca * ax + cb * bx, ca * ay + cb * by, ca * az + cb * bz
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
    ga, gb = gx * t0 + gy * t1 + gz * t2, gx * s0 + gy * s1 + gz * s2
    return ga, gb, haa - bend, hab, hbb - bend


@njit(cache=True)
def _descent(
    ga: float, gb: float, haa: float, hab: float, hbb: float
) -> tuple[float, float, float]:
    """Newton step of a quadratic model with both eigenvalues made positive, and its slope."""
    mean, half = 0.5 * (haa + hbb), 0.5 * (haa - hbb)
    radius = np.sqrt(half * half + hab * hab)
    floor = 1e-3 * (abs(mean) + radius) + 1e-300
    high, low = max(abs(mean + radius), floor), max(abs(mean - radius), floor)
    # Eigenvector of the larger one, by the longer of two formulas.
    vx, vy = hab, radius - half
    if abs(half + radius) > abs(vy):
        vx, vy = half + radius, hab
    length = np.sqrt(vx * vx + vy * vy)
    if length > 0:
        vx, vy = vx / length, vy / length
    else:
        vx, vy = 1.0, 0.0
    along, across = -(ga * vx + gb * vy) / high, -(gb * vx - ga * vy) / low
    qa, qb = along * vx - across * vy, along * vy + across * vx
    return qa, qb, ga * qa + gb * qb


@njit(cache=True)
def newton_step(
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
    t0, t1, t2, s0, s1, s2 = _frame(p)
    ga, gb, haa, hab, hbb = _derivatives(
        p, around, size, u, star, energy, pull, goal, t0, t1, t2, s0, s1, s2
    )
    qa, qb, slope = _descent(ga, gb, haa, hab, hbb)
    return qa * t0 + qb * s0, qa * t1 + qb * s1, qa * t2 + qb * s2, slope
