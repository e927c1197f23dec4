import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import icosphere, sample_sphere, tangent_frame, unit


@pytest.mark.parametrize("level", range(4))
def test_icosphere_counts_radius_and_nesting(level):
    ball = icosphere(level)
    assert len(ball.vertices) == 10 * 4**level + 2
    assert ball.euler == 2
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 1, atol=1e-15)
    finer = icosphere(level + 1).vertices[: len(ball.vertices)]
    np.testing.assert_array_equal(finer, ball.vertices)
    assert (np.einsum("ij,ij->i", ball.face_normals, ball.vertices[ball.faces[:, 0]]) > 0).all()


def test_icosphere_area_tends_to_the_sphere():
    errors = [4 * np.pi - icosphere(level).area for level in range(1, 5)]
    ratios = np.divide(errors[:-1], errors[1:])
    np.testing.assert_allclose(ratios, 4, rtol=0.1)


def test_tangent_frame_is_orthonormal_and_right_handed(rng):
    p = sample_sphere(500, rng)
    frame = tangent_frame(p)
    gram = np.einsum("nij,nik->njk", frame, frame)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-14)
    np.testing.assert_allclose(np.cross(frame[..., 0], frame[..., 1]), p, atol=1e-14)


def test_samples_are_uniform(rng):
    p = sample_sphere(20_000, rng)
    np.testing.assert_allclose(p.mean(axis=0), 0, atol=0.02)
    np.testing.assert_allclose(p.T @ p / len(p), np.eye(3) / 3, atol=0.01)


def test_unit_commutes_with_rotation(rng):
    x, rotation = rng.standard_normal((50, 3)), Rotation.random(random_state=1).as_matrix()
    np.testing.assert_allclose(unit(x @ rotation.T), unit(x) @ rotation.T, atol=1e-15)


def test_surface_samples_follow_the_areas(rng, dumbbell):
    points = sample_surface(dumbbell.face_areas, 200_000, rng)
    share = np.bincount(points.faces, minlength=len(dumbbell.faces)) / len(points)
    np.testing.assert_allclose(share, dumbbell.face_areas / dumbbell.area, atol=5e-4)
    np.testing.assert_allclose(points.barycentric.mean(axis=0), 1 / 3, atol=5e-3)


def test_points_on_corners_are_the_vertices(bumpy):
    corners = SurfacePoints(np.arange(len(bumpy.faces)), np.tile([0.0, 1.0, 0.0], (1280, 1)))
    np.testing.assert_array_equal(
        corners.on(bumpy.vertices, bumpy.faces), bumpy.vertices[bumpy.faces[:, 1]]
    )
