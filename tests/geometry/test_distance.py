import igl
import numpy as np
import pytest

from gensp.geometry.distance import (
    ClosestPointTree,
    barycentric_coordinates,
    closest_point,
    hausdorff,
    morton_order,
    signed_distance,
)
from gensp.geometry.sphere import icosphere


def _dense_samples(mesh, resolution=40):
    """A fine grid of barycentric points on every face: brute force."""
    i, j = np.meshgrid(np.arange(resolution + 1), np.arange(resolution + 1), indexing="ij")
    keep = i + j <= resolution
    u, v = i[keep] / resolution, j[keep] / resolution
    weights = np.stack([1 - u - v, u, v], axis=1)
    return np.einsum("sj,mjc->msc", weights, mesh.vertices[mesh.faces]).reshape(-1, 3)


def test_closest_point_agrees_with_brute_force(rng):
    mesh = icosphere(1).with_vertices(icosphere(1).vertices * np.array([1.5, 1, 0.6]))
    queries = rng.uniform(-2, 2, (60, 3))
    found = closest_point(queries, mesh)
    samples = _dense_samples(mesh)
    brute = np.linalg.norm(queries[:, None] - samples, axis=2).min(axis=1)
    assert (found.distance <= brute + 1e-12).all()
    np.testing.assert_allclose(found.distance, brute, atol=0.02)


def test_closest_points_lie_where_they_are_said_to_lie(bumpy, rng):
    queries = rng.uniform(-2, 2, (500, 3))
    found = closest_point(queries, bumpy)
    np.testing.assert_allclose(found.at.on(bumpy.vertices, bumpy.faces), found.points, atol=1e-12)
    np.testing.assert_allclose(found.at.barycentric.sum(axis=1), 1)
    assert found.at.barycentric.min() >= 0
    np.testing.assert_allclose(np.linalg.norm(queries - found.points, axis=1), found.distance)


def test_order_of_the_queries_does_not_matter(bumpy, rng):
    tree, queries = ClosestPointTree(bumpy), rng.uniform(-2, 2, (300, 3))
    shuffle = rng.permutation(300)
    np.testing.assert_array_equal(
        tree.query(queries[shuffle]).points, tree.query(queries).points[shuffle]
    )


def test_distance_is_rigid_motion_invariant(bumpy, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    queries = rng.uniform(-2, 2, (200, 3))
    moved = bumpy.with_vertices(bumpy.vertices @ rotation.T + 3.0)
    np.testing.assert_allclose(
        closest_point(queries @ rotation.T + 3.0, moved).distance,
        closest_point(queries, bumpy).distance,
        atol=1e-12,
    )


def test_signed_distance_of_the_sphere_is_radius_minus_one(rng):
    ball = icosphere(4)
    queries = rng.uniform(-1.5, 1.5, (4000, 3))
    exact = np.linalg.norm(queries, axis=1) - 1
    # Sagitta of the longest edge of the triangulation.
    edge = np.linalg.norm(np.diff(ball.vertices[ball.edges], axis=1), axis=2).max()
    facet_error = edge**2 / 6
    np.testing.assert_allclose(signed_distance(queries, ball), exact, atol=facet_error)


def test_signed_distance_agrees_with_the_pseudonormal_sign(bumpy, rng):
    queries = rng.uniform(-1.6, 1.6, (3000, 3))
    kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    other = igl.signed_distance(queries, bumpy.vertices, bumpy.faces, sign_type=kind)[0]
    np.testing.assert_allclose(signed_distance(queries, bumpy), other.reshape(-1), atol=1e-10)


def test_hausdorff_distance_of_concentric_spheres(rng):
    ball = icosphere(3)
    grown = ball.with_vertices(ball.vertices * 1.25)
    # The farthest vertex of the outer sphere lies over a vertex of the inner one.
    assert hausdorff(ball, grown) == pytest.approx(0.25, abs=1e-3)
    assert hausdorff(grown, ball) == hausdorff(ball, grown)
    assert hausdorff(ball, ball) == pytest.approx(0, abs=1e-12)


def test_barycentric_weights_survive_triangles_without_area():
    needle = np.array([[[0.0, 0, 0], [2.0, 0, 0], [0.5, 0, 0]], [[1.0, 1, 1]] * 3])
    points = np.array([[0.5, 0, 0], [1.0, 1, 1]])
    weights = barycentric_coordinates(points, needle)
    np.testing.assert_allclose(np.einsum("kj,kjc->kc", weights, needle), points)


def test_morton_order_is_a_permutation_and_keeps_neighbours_together(rng):
    points = rng.uniform(size=(2000, 3))
    order = morton_order(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(2000))

    def jump(x):
        return np.linalg.norm(np.diff(x, axis=0), axis=1).mean()

    assert jump(points[order]) < 0.3 * jump(points)
    assert len(morton_order(np.zeros((0, 3)))) == 0
