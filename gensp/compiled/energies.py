"""Distortion energies of a triangle's map, as functions of two invariants of its Jacobian.

With singular values σ₁ ≥ σ₂ of J, every energy is a function φ(D, j) of D = ‖J‖² = σ₁² + σ₂² and
j = det J = σ₁σ₂, and infinite for j ≤ 0. One table serves the vertex-by-vertex optimisation of
the hierarchical embedding and the Newton iteration of the whole map.
"""

import numpy as np
from numba import njit

DIRICHLET, STRETCH, AMIPS, SIGMA = range(4)

ENERGIES = {
    # ‖J‖² + ‖J⁻¹‖² (Smith & Schaefer 2015).
    "dirichlet": DIRICHLET,
    # ½‖J⁻¹‖² + 10⁻⁴ (σ₁⁶ + σ₂⁶): L² stretch from the sphere to the surface, with the sixth power
    # of its inverse against large triangles (Praun & Hoppe 2003).
    "stretch": STRETCH,
    # exp(s δ), δ = α·½(σ₁/σ₂ + σ₂/σ₁) + (1 − α)·½(j + 1/j) (Fu, Liu & Guo 2015; Hu et al. 2017).
    "amips": AMIPS,
    # √(f − 2 + ε) + τ f², f = ½(‖J‖² + ‖J⁻¹‖²) ≥ 2: about max(σ₁, 1/σ₂)/√2, the quantity that is
    # reported, as a mean; and its largest values dear.
    "sigma": SIGMA,
}

_INVERSE_STRETCH = 1e-4  # of σ₁⁶ + σ₂⁶ = D (D² − 3 j²)
_EXPONENT, _CONFORMAL = 5.0, 0.5
_STEEP = 100.0  # exponents above go on as a parabola: long before exp has no number any more
_ROUND, _TAIL = 0.2, 0.02


@njit(cache=True)
def _exponential(x: float) -> tuple[float, float, float]:
    """exp(x) and two derivatives, continued by its Taylor parabola from `_STEEP` on."""
    power, beyond = np.exp(min(x, _STEEP)), max(x - _STEEP, 0.0)
    slope = power * (1 + beyond)
    return slope + 0.5 * power * beyond * beyond, slope, power


@njit(cache=True)
def energy_value(energy: int, d: float, j: float) -> float:
    """φ(D, j); infinite for a folded or flat triangle."""
    if not j > 0:
        return np.inf
    if energy == STRETCH:
        return 0.5 * d / (j * j) + _INVERSE_STRETCH * d * (d * d - 3 * j * j)
    if energy == AMIPS:
        delta = 0.5 * _CONFORMAL * d / j + 0.5 * (1 - _CONFORMAL) * (j + 1 / j)
        return _exponential(_EXPONENT * delta)[0]
    value = d * (1 + 1 / (j * j))
    if energy == DIRICHLET:
        return value
    f = 0.5 * value
    return np.sqrt(f - 2 + _ROUND) + _TAIL * f * f


@njit(cache=True)
def energy_slopes(energy: int, d: float, j: float) -> tuple[float, float, float, float, float]:
    """φ_D, φ_j, φ_DD, φ_Dj, φ_jj at j > 0."""
    i2 = 1 / (j * j)
    i3, i4 = i2 / j, i2 * i2
    if energy == STRETCH:
        e = _INVERSE_STRETCH
        return (
            0.5 * i2 + 3 * e * (d * d - j * j),
            -d * i3 - 6 * e * d * j,
            6 * e * d,
            -i3 - 6 * e * j,
            3 * d * i4 - 6 * e * d,
        )
    if energy == AMIPS:
        s, a, b = _EXPONENT, 0.5 * _CONFORMAL, 0.5 * (1 - _CONFORMAL)
        delta = a * d / j + b * (j + 1 / j)
        _, slope, bend = _exponential(s * delta)
        u, v = s * a / j, s * (-a * d * i2 + b * (1 - i2))
        mixed, curved = -s * a * i2, s * (2 * a * d * i3 + 2 * b * i3)
        return (
            slope * u,
            slope * v,
            bend * u * u,
            bend * u * v + slope * mixed,
            bend * v * v + slope * curved,
        )
    fd, fj, fdj, fjj = 1 + i2, -2 * d * i3, -2 * i3, 6 * d * i4
    if energy == DIRICHLET:
        return fd, fj, 0.0, fdj, fjj
    f = 0.5 * d * fd
    root = np.sqrt(f - 2 + _ROUND)
    slope, bend = 0.25 / root + _TAIL * f, -0.0625 / (root * root * root) + 0.5 * _TAIL
    return (
        slope * fd,
        slope * fj,
        bend * fd * fd,
        slope * fdj + bend * fd * fj,
        slope * fjj + bend * fj * fj,
    )


@njit(cache=True)
def energy_values_of(energy: int, d: np.ndarray, j: np.ndarray) -> np.ndarray:
    """φ of many triangles (m,)."""
    values = np.empty(len(d))
    for t in range(len(d)):
        values[t] = energy_value(energy, d[t], j[t])
    return values


@njit(cache=True)
def energy_slopes_of(energy: int, d: np.ndarray, j: np.ndarray) -> np.ndarray:
    """φ_D, φ_j, φ_DD, φ_Dj, φ_jj of many triangles (5, m)."""
    slopes = np.empty((5, len(d)))
    for t in range(len(d)):
        slopes[:, t] = energy_slopes(energy, d[t], j[t])
    return slopes
