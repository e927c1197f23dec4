"""Implied correspondences and the rotation after which they err least, where both are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.implied import MatchedMaps, correspondence_error, geodesic_error
from gensp.geometry.mesh import Mesh
from gensp.geometry.pair_rotation import pair_rotation
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_map import SphericalMap

TURN = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()


@pytest.fixture
def points(bumpy: Mesh, rng: np.random.Generator) -> SurfacePoints:
    return sample_surface(bumpy.face_areas, 300, rng)


def radial(mesh: Mesh) -> SphericalMap:
    """The map that sends every vertex of a deformed icosphere to where it came from."""
    return SphericalMap(icosphere(3).vertices, mesh.vertices, mesh.faces, mesh.name)


def test_identical_maps_agree(bumpy: Mesh, points: SurfacePoints) -> None:
    error = correspondence_error(radial(bumpy), radial(bumpy), points, points)
    assert error.max() < 1e-12


def test_shared_parameterization_is_the_ground_truth(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints
) -> None:
    # Both maps come from one icosphere, so equal barycentric coordinates correspond.
    error = correspondence_error(radial(bumpy), radial(ellipsoid), points, points)
    assert error.max() < 1e-12


def test_known_rotation_on_the_sphere_is_the_distance_it_moves_points(
    rng: np.random.Generator,
) -> None:
    ball = icosphere(5)
    still = SphericalMap(ball.vertices, ball.vertices, ball.faces)
    at = sample_surface(ball.face_areas, 200, rng)
    x = at.on(ball.vertices, ball.faces)
    error = correspondence_error(still.rotated(TURN), still, at, at)
    expected = np.linalg.norm(x @ TURN.T - x, axis=1) / np.sqrt(ball.area)
    assert np.allclose(error, expected, atol=2e-4)


def test_along_the_sphere_a_known_rotation_moves_points_by_arcs(rng: np.random.Generator) -> None:
    ball = icosphere(4)
    still = SphericalMap(ball.vertices, ball.vertices, ball.faces)
    at = sample_surface(ball.face_areas, 100, rng)
    x = unit(at.on(ball.vertices, ball.faces))
    arcs = np.arccos(np.einsum("ki,ki->k", x @ TURN.T, x))
    error = geodesic_error(still.rotated(TURN), still, at, at)
    np.testing.assert_allclose(error, arcs / np.sqrt(ball.area), rtol=0.02)


def test_no_way_along_the_surface_is_shorter_than_the_straight_one(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints, rng: np.random.Generator
) -> None:
    other = SphericalMap(_shaken(rng), ellipsoid.vertices, ellipsoid.faces)
    straight = correspondence_error(radial(bumpy), other, points, points)
    along = geodesic_error(radial(bumpy), other, points, points)
    assert (along >= straight * (1 - 1e-12)).all()
    assert along.mean() < 1.2 * straight.mean()


def test_common_rotation_of_both_maps_changes_nothing(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints, rng: np.random.Generator
) -> None:
    other = SphericalMap(_shaken(rng), ellipsoid.vertices, ellipsoid.faces)
    before = correspondence_error(radial(bumpy), other, points, points)
    after = correspondence_error(radial(bumpy).rotated(TURN), other.rotated(TURN), points, points)
    assert before.mean() > 1e-3
    assert np.allclose(before, after, atol=1e-9)


def test_the_rotation_of_one_map_is_found_and_undone(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints, rng: np.random.Generator
) -> None:
    one, other = radial(bumpy), SphericalMap(_shaken(rng), ellipsoid.vertices, ellipsoid.faces)
    shaken = MatchedMaps(one, other, points, points).error(np.eye(3))
    turned = MatchedMaps(one.rotated(TURN), other, points, points)
    found = turned.error(pair_rotation(turned))
    assert turned.error(np.eye(3)) > 3 * shaken
    assert found < 1.1 * shaken


def test_a_part_that_maps_elsewhere_does_not_turn_the_rest(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints
) -> None:
    """Least squares give way to points that are far off; the mean error hardly does."""
    ball = icosphere(3).vertices
    far = ball[:, 2] > 0.5
    swirl = Rotation.from_rotvec(np.where(far, 2.0 * (ball[:, 2] - 0.5), 0)[:, None] * [0, 0, 1.0])
    other = SphericalMap(swirl.apply(ball.copy()), ellipsoid.vertices, ellipsoid.faces)
    matched = MatchedMaps(radial(bumpy), other, points, points)
    found = pair_rotation(matched, [matched.least_squares()])
    assert matched.error(found) < 0.98 * matched.error(matched.least_squares())
    assert matched.error(found) <= 1.02 * matched.error(np.eye(3))


def _shaken(rng: np.random.Generator) -> np.ndarray:
    moved = icosphere(3).vertices + 0.02 * rng.standard_normal(icosphere(3).vertices.shape)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)
