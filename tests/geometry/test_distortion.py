import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.distortion import (
    conformal_distortion,
    distortion,
    isometric_distortion,
    singular_values,
)
from gensp.geometry.sphere import icosphere


def test_identity_is_one():
    ball = icosphere(2)
    found = distortion(ball.vertices, ball.vertices, ball.faces)
    assert found.mean == pytest.approx(1)
    assert found.max == pytest.approx(1)
    assert found.conformal_max == pytest.approx(1)


def test_one_sheared_triangle_by_hand():
    """Both triangles have equal area, so the common scale drops out; J = [[1, 1], [0, 1]]."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    sheared = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])
    values = singular_values(flat, sheared, np.array([[0, 1, 2]]))
    golden = (1 + np.sqrt(5)) / 2
    np.testing.assert_allclose(values, [[golden, 1 / golden]])
    assert isometric_distortion(values)[0] == pytest.approx(golden)
    mean = (golden + 1 / golden) / 2
    assert conformal_distortion(values)[0] == pytest.approx(mean * golden)


def test_uniform_stretch_of_one_axis():
    ball = icosphere(3)
    values = singular_values(ball.vertices * np.array([1, 1, 2.0]), ball.vertices, ball.faces)
    assert (values[:, 0] / values[:, 1]).max() == pytest.approx(2, rel=0.02)


def test_invariance_under_rigid_motion_and_scale(bumpy):
    rotation = Rotation.random(random_state=0).as_matrix()
    ball = icosphere(3)
    plain = singular_values(bumpy.vertices, ball.vertices, ball.faces)
    moved = singular_values(
        7 * bumpy.vertices @ rotation.T + 2, ball.vertices @ rotation, ball.faces
    )
    np.testing.assert_allclose(moved, plain, rtol=1e-10)


def test_collapsed_triangle_is_infinite():
    ball = icosphere(1)
    sphere = ball.vertices.copy()
    sphere[ball.faces[0, 0]] = sphere[ball.faces[0, 1]]
    values = singular_values(ball.vertices, sphere, ball.faces)
    assert isometric_distortion(values)[0] == np.inf
    assert conformal_distortion(values)[0] == np.inf
