"""Registering two spherical maps by a rotation, without ground truth.

After Baden, Crane & Kazhdan 2018 (Möbius registration): a map is seen as a signal on the sphere,
the square root of the surface's area per area of the sphere, and the rotation is where the
correlation of two signals over SO(3) is largest. The correlation below a bandlimit is a
trigonometric polynomial in Euler angles, sampled by one FFT (Kostelec & Rockmore 2008, FFTs on the
rotation group) and maximised between the samples by Newton's method.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int
from scipy.ndimage import maximum_filter
from scipy.spatial.transform import Rotation

from gensp.geometry.harmonics import (
    angular_momentum,
    harmonic_moments,
    heat_kernel,
    rotation_of,
    sphere_grid,
)
from gensp.geometry.sphere import unit

BANDLIMIT = 24
SMOOTHING = 5e-4
_TRUNCATION = 1e-3  # what the smoothed density may have left at its bandlimit
_SMALLEST = 1e-9  # of a signal's variation: below, the density is constant
_STARTS = 3  # samples that are refined for every maximum asked for
_NEWTON_STEPS = 30
_STILL = 1e-12


@dataclass(frozen=True)
class RegisteredRotation:
    """A rotation (or reflection) R of the sphere, u ↦ R u, and the correlation that it reaches.

    The correlation is that of the signals without their means, in [−1, 1].
    """

    rotation: Float[np.ndarray, "3 3"]
    correlation: float


def density_signal(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    areas: Float[np.ndarray, " m"],
    *,
    bandlimit: int = BANDLIMIT,
    smoothing: float = SMOOTHING,
) -> Complex[np.ndarray, "l o"]:
    """Harmonic coefficients of the root of a map's density, √(area of surface / of sphere).

    The surface's area is spread over the chordal triangles and projected. Its harmonics, up to
    twice the bandlimit, are damped by heat flow until the density is smooth at the scale of the
    bandlimit, and the root is taken on a Gauss–Legendre grid. So signals turn with their maps,
    which those of a grid's cells do not, and limbs crowded into a point keep their weight.

    Parameters
    ----------
    areas
        Areas of the surface's faces, at any scale.
    bandlimit
        Degrees below this are kept.
    smoothing
        Time t of the heat kernel exp(−t l(l + 1)) on the signal.
    """
    fine = 2 * bandlimit
    points, masses = _area_points(sphere, faces, areas / areas.sum(), longest=3 / bandlimit)
    time = -np.log(_TRUNCATION) / (fine * (fine + 1))
    moments = harmonic_moments(points, masses, fine) * heat_kernel(fine, time)[:, None]
    grid = sphere_grid(2 * fine)
    root = np.sqrt(np.maximum(grid.values(moments), 0))
    signal = grid.coefficients(root, bandlimit) * heat_kernel(bandlimit, smoothing)[:, None]
    signal[0] = 0  # the mean is the same in every rotation
    return signal


def _area_points(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    masses: Float[np.ndarray, " m"],
    longest: float,
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """The area of a map as masses at the middles of edges, exact for quadratic functions."""
    corners = sphere[faces]
    while True:
        sides = corners[:, [1, 2, 0]] - corners
        large = np.einsum("mki,mki->mk", sides, sides).max(axis=1) > longest**2
        if not large.any():
            break
        split = _quartered(corners[large])
        corners = np.concatenate([corners[~large], split])
        masses = np.concatenate([masses[~large], np.tile(masses[large] / 4, 4)])
    middles = (corners + corners[:, [1, 2, 0]]).reshape(-1, 3)
    return unit(middles), np.repeat(masses / 3, 3)


def _quartered(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "k 3 3"]:
    a, b, c = (corners[:, k] for k in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def rotation_correlation(
    a: Complex[np.ndarray, "l o"], b: Complex[np.ndarray, "l o"], samples: int
) -> Float[np.ndarray, "s s s"]:
    """Correlation ∫ a(R⁻¹x) b(x) dx at R = R_z(α) R_y(β) R_z(γ), angles 2πi / samples each.

    With d(β) = V exp(−iβk) Vᴴ it is the Fourier series with coefficients
    Σ_l conj(b_lm) V_mk conj(V_nk) a_ln at (m, k, n).

    Parameters
    ----------
    samples
        At least 2L − 1. β runs over the whole circle, so every rotation is met twice.
    """
    vectors = angular_momentum(len(a)).eigenvectors
    left = (b.conj()[:, :, None] * vectors).transpose(2, 1, 0)
    right = (a[:, :, None] * vectors.conj()).transpose(2, 0, 1)
    series = (left @ right).transpose(1, 0, 2)
    place = np.arange(1 - len(a), len(a)) % samples
    padded = np.zeros((samples, samples, samples), dtype=complex)
    padded[np.ix_(place, place, place)] = series
    return scipy.fft.fftn(padded, overwrite_x=True).real


def register_rotation(
    a: Complex[np.ndarray, "l o"],
    b: Complex[np.ndarray, "l o"],
    *,
    reflection: bool = False,
    candidates: int = 4,
    separation: float = 0.5,
) -> list[RegisteredRotation]:
    """Rotations that take one signal to another, best first, each a maximum of the correlation.

    Parameters
    ----------
    a, b
        Signals of two maps (`density_signal`); R takes the first map's sphere to the second's.
    reflection
        Whether to try R with determinant −1 as well.
    candidates
        How many maxima to give at most.
    separation
        Least angle between two of them, in radians.
    """
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    if scale <= _SMALLEST**2:
        # A density that is constant looks the same from everywhere.
        return [RegisteredRotation(np.eye(3), 0.0)]
    found = _maxima(a, b, candidates, separation, 1.0)
    if reflection:
        odd = (-1.0) ** np.arange(len(a))[:, None]
        found += _maxima(odd * a, b, candidates, separation, -1.0)
    ranked = sorted(found, key=lambda maximum: -maximum.correlation)[:candidates]
    return [RegisteredRotation(one.rotation, one.correlation / scale) for one in ranked]


def _maxima(
    a: Complex[np.ndarray, "l o"],
    b: Complex[np.ndarray, "l o"],
    count: int,
    separation: float,
    side: float,
) -> list[RegisteredRotation]:
    """Refined maxima among the rotations, times ±1."""
    starts = _grid_maxima(a, b)
    # Several samples may climb to one maximum, and the highest sample need not climb highest.
    starts = starts[_apart(starts, separation, _STARTS * count)]
    refined = [refine_rotation(a, b, start) for start in starts]
    refined.sort(key=lambda maximum: -maximum.correlation)
    kept = _apart(np.stack([one.rotation for one in refined]), separation, count)
    found = [refined[place] for place in kept]
    return [RegisteredRotation(side * one.rotation, one.correlation) for one in found]


def _grid_maxima(
    a: Complex[np.ndarray, "l o"], b: Complex[np.ndarray, "l o"]
) -> Float[np.ndarray, "k 3 3"]:
    """Samples that no neighbour exceeds, largest first."""
    samples = scipy.fft.next_fast_len(2 * len(a))
    values = rotation_correlation(a, b, samples)
    peak = (values >= maximum_filter(values, size=3, mode="wrap")).nonzero()
    half = peak[1] <= samples // 2
    i, j, k = (index[half] for index in peak)
    order = np.argsort(-values[i, j, k], kind="stable")
    step = 2 * np.pi / samples
    return rotation_of(step * i[order], step * j[order], step * k[order])


def _apart(rotations: Float[np.ndarray, "k 3 3"], separation: float, count: int) -> list[int]:
    """Places of the first rotations that keep an angle from all that were taken before."""
    kept = [0]
    while len(kept) < count:
        traces = np.einsum("kij,lij->kl", rotations, rotations[kept]).max(axis=1)
        far = np.flatnonzero(traces < 1 + 2 * np.cos(separation))
        if len(far) == 0:
            break
        kept.append(int(far[0]))
    return kept


def refine_rotation(
    a: Complex[np.ndarray, "l o"],
    b: Complex[np.ndarray, "l o"],
    start: Float[np.ndarray, "3 3"],
) -> RegisteredRotation:
    """The maximum of the correlation ∫ a(R⁻¹x) b(x) dx near a rotation, by Newton's method.

    Turning by exp(ω) changes the coefficients by exp(−iω·J), so gradient and Hessian by ω are
    Im⟨b, J_k a⟩ and −Re⟨J_j b, J_k a⟩, symmetrised. The value is not normalised.
    """
    momentum = angular_momentum(len(a))
    rotation, turned = start, momentum.rotated(a, start)
    value, pushed = float(np.vdot(b, turned).real), momentum(b)
    for _ in range(_NEWTON_STEPS):
        moved = momentum(turned)
        gradient = np.einsum("lo,klo->k", b.conj(), moved).imag
        hessian = -np.einsum("jlo,klo->jk", pushed.conj(), moved).real
        curvature, axes = np.linalg.eigh(hessian + hessian.T)
        stiff = np.maximum(np.abs(curvature) / 2, 1e-12 * np.abs(curvature).max())
        step = axes @ ((axes.T @ gradient) / stiff)
        while np.linalg.norm(step) > _STILL:
            trial = Rotation.from_rotvec(step).as_matrix() @ rotation
            image = momentum.rotated(a, trial)
            reached = float(np.vdot(b, image).real)
            if reached > value:
                break
            step /= 2
        else:
            break
        rotation, turned, value = trial, image, reached
    return RegisteredRotation(rotation, value)
