"""Spherical harmonics: moments of points, Gauss–Legendre grids, rotation of coefficients.

Coefficients a_lm of Σ a_lm Y_lm below a bandlimit L are kept as complex (L, 2L − 1) arrays: row l,
column m + L − 1, zero where |m| > l. Y_lm are orthonormal with the Condon–Shortley phase, so that
rotations act by Wigner's D(R) = exp(−iαJ_z) exp(−iβJ_y) exp(−iγJ_z) for R = R_z(α) R_y(β) R_z(γ).
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Complex, Float, Int

_CHUNK = 8192


def heat_kernel(bandlimit: int, time: float) -> Float[np.ndarray, " l"]:
    """Factors exp(−t l(l + 1)) by which heat flow of time t damps each degree."""
    degree = np.arange(bandlimit)
    return np.exp(-time * degree * (degree + 1))


def harmonic_moments(
    points: Float[np.ndarray, "k 3"], masses: Float[np.ndarray, " k"], bandlimit: int
) -> Complex[np.ndarray, "l o"]:
    """Coefficients Σ_i w_i conj(Y_lm(x_i)) of point masses on the unit sphere."""
    moments = np.zeros((bandlimit, 2 * bandlimit - 1), dtype=complex)
    for start in range(0, len(points), _CHUNK):
        x, y, z = points[start : start + _CHUNK].T
        power = masses[start : start + _CHUNK].astype(complex)
        for m in range(bandlimit):
            table = _legendre(z, bandlimit, m)
            sums = table @ np.stack([power.real, power.imag], axis=1)
            moments[m:, bandlimit - 1 + m] += sums[:, 0] + 1j * sums[:, 1]
            power = power * (x - 1j * y)
    return _with_negative_orders(moments)


def _legendre(z: Float[np.ndarray, " k"], bandlimit: int, m: int) -> Float[np.ndarray, "j k"]:
    """Normalised P_lm(z) / (1 − z²)^{m/2} for l = m, …, L − 1, by the recurrence in l."""
    table = np.empty((bandlimit - m, len(z)))
    k = np.arange(1, m + 1)
    table[0] = (-1) ** m * np.sqrt(np.prod((2 * k + 1) / (2 * k)) / (4 * np.pi))
    if bandlimit - m > 1:
        table[1] = np.sqrt(2 * m + 3) * z * table[0]
    for l in range(m + 2, bandlimit):  # noqa: E741
        before = math.sqrt(((l - 1) ** 2 - m**2) / (4 * (l - 1) ** 2 - 1))
        scale = math.sqrt((4 * l**2 - 1) / (l**2 - m**2))
        row = np.multiply(z, table[l - m - 1], out=table[l - m])
        row -= before * table[l - m - 2]
        row *= scale
    return table


def _with_negative_orders(a: Complex[np.ndarray, "l o"]) -> Complex[np.ndarray, "l o"]:
    """Fill in the orders m < 0 of a real function, a_{l,−m} = (−1)^m conj(a_lm)."""
    top = a.shape[0] - 1
    signs = (-1.0) ** np.arange(1, top + 1)
    a[:, :top] = (signs * a[:, top + 1 :].conj())[:, ::-1]
    return a


class SphereGrid:
    """Gauss–Legendre latitudes by equal longitudes: exact for products below the bandlimit.

    Parameters
    ----------
    bandlimit
        Functions below this degree are integrated against each other exactly.

    Attributes
    ----------
    points
        Unit vectors (bandlimit, 2 · bandlimit, 3).
    """

    def __init__(self, bandlimit: int) -> None:
        self.bandlimit = bandlimit
        self._z, self._weights = np.polynomial.legendre.leggauss(bandlimit)
        longitude = np.pi * np.arange(2 * bandlimit) / bandlimit
        radius = np.sqrt(1 - self._z**2)[:, None]
        circle = np.stack([np.cos(longitude), np.sin(longitude)], axis=1)
        height = np.broadcast_to(self._z[:, None, None], (bandlimit, 2 * bandlimit, 1))
        self.points = np.concatenate([radius[:, :, None] * circle, height], axis=2)

    @cached_property
    def _tables(self) -> list[Float[np.ndarray, "j k"]]:
        radius = np.sqrt(1 - self._z**2)
        count = self.bandlimit
        return [_legendre(self._z, count, m) * radius**m for m in range(count)]

    def values(self, a: Complex[np.ndarray, "l o"]) -> Float[np.ndarray, "t p"]:
        """Values at the grid's points of a real function given by its coefficients."""
        count, top = len(a), len(a) - 1
        modes = np.zeros((self.bandlimit, self.bandlimit + 1), dtype=complex)
        for m in range(count):
            modes[:, m] = self._tables[m][: count - m].T @ a[m:, top + m]
        # The sum over m of both signs is what irfft takes from m ≥ 0.
        return np.fft.irfft(modes, 2 * self.bandlimit, axis=1) * 2 * self.bandlimit

    def coefficients(
        self, values: Float[np.ndarray, "t p"], bandlimit: int
    ) -> Complex[np.ndarray, "l o"]:
        """Coefficients below a bandlimit of a real function given at the grid's points."""
        modes = np.fft.rfft(values, axis=1) * (np.pi / self.bandlimit)
        a = np.zeros((bandlimit, 2 * bandlimit - 1), dtype=complex)
        for m in range(bandlimit):
            rows = self._tables[m][: bandlimit - m] * self._weights
            a[m:, bandlimit - 1 + m] = rows @ modes[:, m]
        return _with_negative_orders(a)


@lru_cache(maxsize=4)
def sphere_grid(bandlimit: int) -> SphereGrid:
    """The grid of a bandlimit, kept for the next call."""
    return SphereGrid(bandlimit)


@dataclass(frozen=True)
class AngularMomentum:
    """The operators J_x, J_y, J_z on coefficients, and the eigenvectors of J_y.

    With J_y = V diag(k) Vᴴ in every degree, Wigner's d(β) = V exp(−iβk) Vᴴ.

    Attributes
    ----------
    order
        Orders m = −(L − 1), …, L − 1 of the columns; also the eigenvalues k.
    raising
        Factors √(l(l + 1) − m(m + 1)) with which J₊ takes m to m + 1.
    eigenvectors
        V of every degree, rows m and columns k, zero outside of |m|, |k| ≤ l.
    """

    order: Int[np.ndarray, " o"]
    raising: Float[np.ndarray, "l o"]
    eigenvectors: Complex[np.ndarray, "l o o"]

    def __call__(self, a: Complex[np.ndarray, "l o"]) -> Complex[np.ndarray, "3 l o"]:
        """J_x a, J_y a and J_z a."""
        up, down = np.zeros_like(a), np.zeros_like(a)
        up[:, 1:] = (self.raising * a)[:, :-1]
        down[:, :-1] = self.raising[:, :-1] * a[:, 1:]
        return np.stack([(up + down) / 2, (up - down) / 2j, self.order * a])

    def rotated(
        self, a: Complex[np.ndarray, "l o"], rotation: Float[np.ndarray, "3 3"]
    ) -> Complex[np.ndarray, "l o"]:
        """Coefficients of x ↦ f(R⁻¹ x) from those of f."""
        alpha, beta, gamma = euler_angles(rotation)
        phase = np.exp(-1j * np.outer([alpha, beta, gamma], self.order))
        inner = (phase[2] * a)[:, None] @ self.eigenvectors.conj()
        turned = self.eigenvectors @ (phase[1] * inner).swapaxes(1, 2)
        return phase[0] * turned[:, :, 0]


@lru_cache(maxsize=4)
def angular_momentum(bandlimit: int) -> AngularMomentum:
    """The operators below a bandlimit, kept for the next call."""
    top = bandlimit - 1
    order = np.arange(-top, top + 1)
    degree = np.arange(bandlimit)[:, None]
    raising = np.sqrt(np.maximum(degree * (degree + 1) - order * (order + 1), 0))
    raising[np.abs(order) > degree] = 0
    vectors = np.zeros((bandlimit, 2 * top + 1, 2 * top + 1), dtype=complex)
    for l in range(bandlimit):  # noqa: E741
        inside = slice(top - l, top + l + 1)
        climb = np.diag(raising[l, top - l : top + l], -1)
        # Eigenvalues come in ascending order: k = −l, …, l.
        vectors[l, inside, inside] = np.linalg.eigh((climb - climb.T) / 2j)[1]
    return AngularMomentum(order, raising, vectors)


def euler_angles(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Angles α, β, γ with R = R_z(α) R_y(β) R_z(γ) and 0 ≤ β ≤ π."""
    alpha = np.arctan2(rotation[1, 2], rotation[0, 2])
    # The other angles follow from R_z(−α) R, so that they fit α where it is ill determined.
    cosine, sine = np.cos(alpha), np.sin(alpha)
    first = cosine * rotation[0] + sine * rotation[1]
    second = cosine * rotation[1] - sine * rotation[0]
    beta = np.arctan2(first[2], rotation[2, 2])
    return float(alpha), float(beta), float(np.arctan2(second[0], second[1]))


def rotation_of(
    alpha: Float[np.ndarray, " k"], beta: Float[np.ndarray, " k"], gamma: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3 3"]:
    """Rotations R_z(α) R_y(β) R_z(γ)."""
    (ca, cb, cg), (sa, sb, sg) = np.cos([alpha, beta, gamma]), np.sin([alpha, beta, gamma])
    rows = [
        [ca * cb * cg - sa * sg, -ca * cb * sg - sa * cg, ca * sb],
        [sa * cb * cg + ca * sg, -sa * cb * sg + ca * cg, sa * sb],
        [-sb * cg, sb * sg, cb],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
