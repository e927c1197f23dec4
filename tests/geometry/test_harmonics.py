"""Spherical harmonics against scipy, and Wigner's matrices against turned points."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import lpmv

from gensp.geometry.harmonics import (
    SphereGrid,
    angular_momentum,
    euler_angles,
    harmonic_moments,
    heat_kernel,
    rotation_of,
)
from gensp.geometry.sphere import sample_sphere

LIMIT = 9


@pytest.fixture
def moments(rng):
    points, masses = sample_sphere(12, rng), rng.random(12)
    return points, masses, harmonic_moments(points, masses, LIMIT)


def harmonic(l, m, points):  # noqa: E741
    """Y_lm for m ≥ 0 from scipy's associated Legendre functions."""
    longitude = np.arctan2(points[:, 1], points[:, 0])
    ratio = np.prod(np.arange(l - m + 1, l + m + 1, dtype=float))
    scale = np.sqrt((2 * l + 1) / (4 * np.pi * ratio))
    return scale * lpmv(m, l, points[:, 2]) * np.exp(1j * m * longitude)


def test_moments_are_sums_of_scipys_harmonics(moments):
    points, masses, found = moments
    for l in range(LIMIT):  # noqa: E741
        for m in range(l + 1):
            expected = masses @ harmonic(l, m, points).conj()
            assert found[l, LIMIT - 1 + m] == pytest.approx(expected, abs=1e-12)
            assert found[l, LIMIT - 1 - m] == pytest.approx((-1) ** m * expected.conj(), abs=1e-12)


def test_grid_gives_back_what_it_was_given(moments):
    grid = SphereGrid(LIMIT + 2)
    np.testing.assert_allclose(
        grid.coefficients(grid.values(moments[2]), LIMIT), moments[2], atol=1e-12
    )


def test_grid_values_are_the_series_at_its_points(moments):
    grid = SphereGrid(LIMIT)
    at = grid.points[4, :5]
    series = np.einsum("lo,klo->k", moments[2], _all_harmonics(at))
    np.testing.assert_allclose(grid.values(moments[2])[4, :5], series.real, atol=1e-11)
    np.testing.assert_allclose(series.imag, 0, atol=1e-11)


def _all_harmonics(points):
    one = np.ones(1)
    return np.stack([harmonic_moments(p[None], one, LIMIT).conj() for p in points])


def test_rotated_coefficients_are_those_of_turned_points(moments):
    points, masses, found = moments
    for rotation in Rotation.random(5, random_state=1).as_matrix():
        turned = harmonic_moments(points @ rotation.T, masses, LIMIT)
        np.testing.assert_allclose(
            angular_momentum(LIMIT).rotated(found, rotation), turned, atol=1e-12
        )


def test_momentum_is_the_derivative_of_turning(moments):
    momentum, a, step = angular_momentum(LIMIT), moments[2], 1e-5
    for axis, moved in zip(np.eye(3), momentum(a), strict=True):
        ahead, back = (
            momentum.rotated(a, Rotation.from_rotvec(s * axis).as_matrix()) for s in (step, -step)
        )
        np.testing.assert_allclose((ahead - back) / (2 * step), -1j * moved, atol=1e-6)


@pytest.mark.parametrize("beta", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_euler_angles_give_the_rotation_also_at_the_poles(beta):
    rotation = rotation_of(np.array([0.7]), np.array([beta]), np.array([-2.0]))[0]
    np.testing.assert_allclose(
        rotation, Rotation.from_euler("ZYZ", [0.7, beta, -2.0]).as_matrix(), atol=1e-15
    )
    angles = [np.array([angle]) for angle in euler_angles(rotation)]
    np.testing.assert_allclose(rotation_of(*angles)[0], rotation, atol=1e-14)


def test_heat_flow_halved_twice_is_heat_flow():
    np.testing.assert_allclose(heat_kernel(LIMIT, 0.02) ** 2, heat_kernel(LIMIT, 0.04))
    assert heat_kernel(LIMIT, 0.1)[2] == pytest.approx(np.exp(-0.6))
