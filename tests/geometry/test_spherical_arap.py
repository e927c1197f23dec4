"""As-rigid-as-possible maps: known energies, the global step against its gradient, invariance."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.mesh import normalize
from gensp.geometry.operators import cotangent_laplacian
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_arap import RigidityEnergy, rigid_map, sphere_centre

TURN = Rotation.from_rotvec([0.5, -1.1, 0.3]).as_matrix()


def test_turned_surface_costs_nothing(bumpy):
    rigidity = RigidityEnergy(bumpy)
    turned = bumpy.vertices @ TURN.T + 3
    assert rigidity.energy(turned, rigidity.frames(turned)) < 1e-20


def test_scaled_surface_costs_its_change_of_edge_lengths(bumpy):
    rigidity = RigidityEnergy(bumpy)
    scaled = 1.1 * bumpy.vertices
    # Σ ½ cot θ |e|² of a triangle is twice its area.
    expected = 0.1**2 * 2 * bumpy.area
    assert rigidity.energy(scaled, rigidity.frames(scaled)) == pytest.approx(expected)


def test_frames_are_orthonormal_and_no_other_is_better(bumpy, rng):
    rigidity, u = RigidityEnergy(bumpy), unit(bumpy.vertices)
    frames = rigidity.frames(u)
    np.testing.assert_allclose(
        frames.swapaxes(1, 2) @ frames, np.broadcast_to(np.eye(2), (len(frames), 2, 2)), atol=1e-12
    )
    least = rigidity.energy(u, frames)
    for rotation in Rotation.random(20, random_state=0).as_matrix():
        turn = Rotation.from_matrix(rotation) ** 0.1
        assert rigidity.energy(u, turn.as_matrix() @ frames) > least


def test_positions_of_the_global_step_are_where_the_energy_is_least(bumpy, rng):
    rigidity, u = RigidityEnergy(bumpy), unit(bumpy.vertices)
    frames, step = rigidity.frames(u), 1e-6
    slope = 2 * (cotangent_laplacian(bumpy) @ u - rigidity.pull(frames))
    for _ in range(3):
        moved = rng.standard_normal(u.shape)
        ahead, back = (rigidity.energy(u + s * moved, frames) for s in (step, -step))
        assert (ahead - back) / (2 * step) == pytest.approx(np.sum(slope * moved), rel=1e-5)


def test_sphere_is_its_own_map():
    ball = icosphere(3)
    found = rigid_map(normalize(ball), ball.vertices)
    assert found.converged
    np.testing.assert_allclose(found.sphere, ball.vertices, atol=2e-3)


def test_energy_falls_and_turns_change_nothing(bumpy):
    mesh = normalize(bumpy)
    rigidity, start = RigidityEnergy(mesh), unit(mesh.vertices)
    found = rigid_map(mesh, start)
    assert found.energy < 0.9 * rigidity.energy(start, rigidity.frames(start))
    np.testing.assert_allclose(np.linalg.norm(found.sphere, axis=1), 1)
    turned = rigid_map(mesh, start @ TURN.T)
    np.testing.assert_allclose(turned.sphere, found.sphere @ TURN.T, atol=1e-9)


def test_centre_of_a_shifted_sphere_is_the_shift(rng):
    shift = np.array([0.3, -0.2, 0.5])
    points = 2 * unit(rng.standard_normal((50, 3))) + shift
    np.testing.assert_allclose(sphere_centre(points, rng.random(50)), shift, atol=1e-12)
