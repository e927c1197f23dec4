"""Consistency measures against maps whose disagreement is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.consistency import (
    GeneratedShape,
    HausdorffIndex,
    area_uniform_weights,
    coverage,
    nearest_neighbours,
    prediction_error,
    sphere_uniform_weights,
)
from gensp.geometry.distance import hausdorff
from gensp.geometry.implied import correspondence_error
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap

TURN = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()


@pytest.fixture
def points(bumpy: Mesh, rng: np.random.Generator) -> SurfacePoints:
    return sample_surface(bumpy.face_areas, 300, rng)


def radial(mesh: Mesh) -> SphericalMap:
    """The map that sends every vertex of a deformed icosphere to where it came from."""
    return SphericalMap(icosphere(3).vertices, mesh.vertices, mesh.faces, mesh.name)


def test_a_generator_that_is_right_has_no_error(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints
) -> None:
    first, second = GeneratedShape(bumpy, bumpy), GeneratedShape(ellipsoid, ellipsoid)
    assert prediction_error(first, second, points, points).max() < 1e-12


def test_generated_surfaces_on_the_shapes_err_as_their_maps_do(
    bumpy: Mesh, ellipsoid: Mesh, points: SurfacePoints
) -> None:
    """The other route: maps that are read off the generated surfaces."""
    turned = radial(ellipsoid).rotated(TURN)
    image = ellipsoid.with_vertices(turned.to_surface(icosphere(3).vertices))
    shapes = GeneratedShape(bumpy, bumpy), GeneratedShape(ellipsoid, image)
    found = prediction_error(*shapes, points, points)
    expected = correspondence_error(radial(bumpy), turned, points, points)
    assert expected.mean() > 0.05
    np.testing.assert_allclose(found, expected, atol=0.02 * expected.mean())


def test_weights_follow_the_area_they_stand_for(rng: np.random.Generator) -> None:
    ball = icosphere(3)
    # The northern half is stretched, so it has more area but half of the sphere.
    tall = ball.vertices * np.where(ball.vertices[:, 2:] > 0, [1, 1, 4], [1, 1, 1])
    map = SphericalMap(ball.vertices, tall, ball.faces)
    at = sample_surface(map.mesh.face_areas, 400, rng)
    north = at.on(tall, ball.faces)[:, 2] > 0
    share = map.mesh.face_areas[tall[ball.faces].mean(axis=1)[:, 2] > 0].sum() / map.mesh.area
    by_area = area_uniform_weights(map, at, 20_000, rng)
    by_sphere = sphere_uniform_weights(map, at, 20_000, rng)
    assert by_area.sum() == pytest.approx(1)
    assert by_area[north].sum() == pytest.approx(share, abs=0.03)
    assert by_sphere[north].sum() == pytest.approx(0.5, abs=0.03)


def test_coverage_of_an_offset_sphere_is_the_offset() -> None:
    ball = icosphere(4)
    inner = ball.with_vertices(0.9 * ball.vertices)
    found = coverage(ball, inner)
    assert found.mean == pytest.approx(0.1 / np.sqrt(ball.area), rel=0.02)
    assert found.max == pytest.approx(found.mean, rel=0.02)
    assert coverage(ball, ball).max < 1e-12


def test_hausdorff_with_bounds_equals_the_exhaustive_one(
    bumpy: Mesh, ellipsoid: Mesh, dumbbell: Mesh
) -> None:
    for a, b in ((bumpy, ellipsoid), (dumbbell, bumpy), (ellipsoid, ellipsoid)):
        assert HausdorffIndex(a).distance(HausdorffIndex(b)) == pytest.approx(
            hausdorff(a, b), abs=1e-12
        )


def test_neighbour_graph_joins_each_shape_to_its_nearest() -> None:
    place = np.array([0.0, 1.0, 2.5, 10.0])
    joined = nearest_neighbours(np.abs(place[:, None] - place), 1)
    edges = {(int(i), int(j)) for i, j in np.argwhere(joined) if i < j}
    assert edges == {(0, 1), (1, 2), (2, 3)}
    assert nearest_neighbours(np.abs(place[:, None] - place), 6).sum() == 12
