import numpy as np
import pytest

from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import ball_inversion, best_rotation, moebius_center
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import icosphere, sample_sphere, unit


def _centroid(sphere, faces, areas):
    return (areas / areas.sum()) @ unit(sphere[faces].mean(axis=1))


@pytest.mark.parametrize("centre", [(0.2, 0.1, 0.0), (0.7, -0.4, 0.3), (0.0, 0.0, 0.97)])
def test_centring_undoes_a_moebius_distortion(centre):
    ball = icosphere(4)
    distorted = ball_inversion(ball.vertices, np.array(centre))
    assert np.linalg.norm(_centroid(distorted, ball.faces, ball.face_areas)) > 0.1
    centred = moebius_center(distorted, ball.faces, ball.face_areas)
    assert np.linalg.norm(_centroid(centred, ball.faces, ball.face_areas)) < 1e-9
    rotation = best_rotation(centred, ball.vertices)
    np.testing.assert_allclose(centred @ rotation.T, ball.vertices, atol=2e-3)


def test_centring_makes_equivalent_maps_equal(bumpy, rng):
    start = unit(bumpy.vertices)
    first = moebius_center(start, bumpy.faces, bumpy.face_areas)
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    moved = ball_inversion(start @ rotation.T, np.array([0.3, 0.2, -0.5]))
    second = moebius_center(moved, bumpy.faces, bumpy.face_areas)
    found = best_rotation(second, first, allow_reflection=True)
    np.testing.assert_allclose(second @ found.T, first, atol=5e-3)


def test_ball_inversion_is_undone_by_the_opposite_centre(rng):
    points, centre = sample_sphere(200, rng), np.array([0.5, -0.2, 0.6])
    moved = ball_inversion(points, centre)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1)
    np.testing.assert_allclose(ball_inversion(moved, -centre), points, atol=1e-12)


def test_ball_inversion_keeps_orientation_and_angles():
    ball = icosphere(4)
    moved = ball_inversion(ball.vertices, np.array([0.6, 0.0, 0.3]))
    assert not bad_faces(moved, ball.faces).any()

    def corner_cosine(u):
        a, b, c = (u[ball.faces[:, k]] for k in range(3))
        return np.sum(unit(b - a) * unit(c - a), axis=1)

    np.testing.assert_allclose(corner_cosine(moved), corner_cosine(ball.vertices), atol=0.15)


def test_map_crowded_into_one_point_cannot_be_centred():
    ball = icosphere(2)
    areas = np.full(len(ball.faces), 1e-6)
    areas[0] = 1.0
    with pytest.raises(NotEmbeddable, match="Möbius"):
        moebius_center(ball.vertices, ball.faces, areas)


@pytest.mark.parametrize("reflected", [False, True])
def test_best_rotation_recovers_a_known_one(reflected, rng):
    points = rng.standard_normal((50, 3)) * np.array([1, 0.5, 0.2])
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation) * (-1 if reflected else 1)
    found = best_rotation(points, points @ rotation.T, allow_reflection=reflected)
    np.testing.assert_allclose(found, rotation, atol=1e-12)


def test_best_rotation_never_reflects_unless_allowed(rng):
    points = rng.standard_normal((50, 3))
    found = best_rotation(points, -points)
    assert np.linalg.det(found) == pytest.approx(1)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)


def test_weights_of_zero_remove_points(rng):
    points = rng.standard_normal((50, 3))
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    image = points @ rotation.T
    image[:20] = rng.standard_normal((20, 3))
    weights = np.where(np.arange(50) < 20, 0.0, 1.0)
    np.testing.assert_allclose(best_rotation(points, image, weights), rotation, atol=1e-12)
