import numpy as np
import pytest

from gensp.geometry.alignment import ball_inversion
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import refine_map
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.refine import invert, shrinking, thin_faces, untangle
from gensp.geometry.sphere import icosphere, tangent_frame, unit


def _jittered(level, size, rng):
    """An icosphere map whose vertices strayed by `size` edge lengths."""
    ball = icosphere(level)
    edge = np.linalg.norm(np.diff(ball.vertices[ball.edges], axis=1), axis=2).mean()
    return unit(ball.vertices + size * edge * rng.standard_normal(ball.vertices.shape))


def test_inversion_of_the_generated_vertices_is_exact(bumpy):
    ball = icosphere(3)
    np.testing.assert_allclose(
        invert(bumpy.vertices, bumpy, ball.vertices).sphere, ball.vertices, atol=1e-9
    )


def test_inversion_of_surface_points_is_barycentric(bumpy, rng):
    ball = icosphere(3)
    weights = rng.dirichlet(np.ones(3), len(ball.faces))
    points = np.einsum("mj,mjc->mc", weights, bumpy.vertices[bumpy.faces])
    expected = unit(np.einsum("mj,mjc->mc", weights, ball.vertices[ball.faces]))
    found = invert(points, bumpy, ball.vertices).sphere
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_a_map_without_folds_is_left_alone():
    ball = icosphere(3)
    untangled = untangle(ball.vertices, ball.faces)
    assert (untangled.clean, untangled.rounds) == (True, 0)
    np.testing.assert_allclose(untangled.sphere, ball.vertices, atol=1e-15)


@pytest.mark.parametrize("size", [0.35, 0.5, 0.7])
def test_randomly_folded_faces_are_repaired(size, rng):
    ball, folded = icosphere(4), _jittered(4, size, rng)
    assert bad_faces(folded, ball.faces).mean() > 0.02
    untangled = untangle(folded, ball.faces)
    assert untangled.clean
    assert untangled.rounds > 0
    assert not bad_faces(untangled.sphere, ball.faces).any()
    assert map_degree(untangled.sphere, ball.faces) == 1


def test_only_the_neighbourhood_of_a_fold_moves(rng):
    ball = icosphere(4)
    folded = ball.vertices.copy()
    folded[0] = unit(folded[0] + 0.3 * tangent_frame(folded[:1])[0, :, 0])
    assert bad_faces(folded, ball.faces).any()
    untangled = untangle(folded, ball.faces)
    assert untangled.clean
    far = ball.vertices @ ball.vertices[0] < 0
    np.testing.assert_allclose(untangled.sphere[far], ball.vertices[far], atol=1e-15)


def test_folds_are_repaired_at_any_scale():
    ball = icosphere(4)
    # A conformal squeeze: the triangles around one pole shrink to areas of 1e-17.
    squeezed = ball_inversion(ball.vertices, np.array([0.0, 0.0, 1 - 1e-7]))
    assert not bad_faces(squeezed, ball.faces).any()
    smallest = Mesh(squeezed, ball.faces).face_areas.argmin()
    assert Mesh(squeezed, ball.faces).face_areas.min() < 1e-16
    first, second, _ = ball.faces[smallest]
    folded = squeezed.copy()
    folded[[first, second]] = squeezed[[second, first]]
    assert bad_faces(folded, ball.faces).any()
    untangled = untangle(folded, ball.faces)
    assert untangled.clean
    assert not bad_faces(untangled.sphere, ball.faces).any()


def test_hopeless_map_is_said_to_be_unclean():
    ball = icosphere(2)
    collapsed = np.repeat(ball.vertices[:1], len(ball.vertices), axis=0)
    assert not untangle(collapsed, ball.faces, max_rounds=3).clean


def test_a_map_that_is_flat_everywhere_is_left_alone(rng):
    """Around every vertex something is wrong: none is left that could hold the others."""
    ball = icosphere(2)
    circle = unit(rng.standard_normal(ball.vertices.shape) * [1, 1, 0])
    assert bad_faces(circle, ball.faces).all()
    untangled = untangle(circle, ball.faces)
    assert (untangled.clean, untangled.rounds) == (False, 0)


def test_thin_faces_are_relative_to_their_own_size():
    needle = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-8, 0]])
    fat = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.9, 0]])
    shapes = [1e-2 * needle, 1e-2 * fat, 1e-8 * needle, 1e-8 * fat]
    vertices = unit(np.concatenate(shapes) + np.array([0.0, 0, 1]))
    faces = np.arange(12).reshape(4, 3)
    assert thin_faces(vertices, faces, 1e-7).tolist() == [True, False, True, False]


def test_a_triangle_around_a_great_circle_is_thin():
    angles = np.array([0, 2, 4]) * np.pi / 3
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    faces = np.array([[0, 1, 2]])
    assert thin_faces(ring, faces, 1e-7).all()
    assert not thin_faces(unit(ring + np.array([0, 0, 0.1])), faces, 1e-7).any()


def test_folded_prediction_becomes_a_refined_bijection(bumpy, rng):
    shape = normalize(bumpy)
    noise = 0.15 * rng.standard_normal(shape.vertices.shape)
    generated = Mesh(shape.vertices + noise, shape.faces)
    predicted = invert(shape.vertices, generated, icosphere(3).vertices).sphere
    assert bad_faces(predicted, shape.faces).any()
    untangled = untangle(predicted, shape.faces)
    refined = refine_map(shape, untangled.sphere, target=predicted, pull=30.0)
    assert not bad_faces(refined.sphere, shape.faces).any()
    assert map_degree(refined.sphere, shape.faces) == 1


def test_shrinking_is_the_ratio_of_areas():
    """A Möbius map of the sphere shrinks by its own conformal factor; the identity does not."""
    ball = normalize(icosphere(5))
    u = unit(ball.vertices)
    np.testing.assert_allclose(shrinking(u, ball), 1, rtol=2e-3)
    factor = 2.0  # a dilation of the plane seen from the south pole
    z = u[:, 2]
    near, far = 1 + z, (1 - z) / factor**2
    moved = np.stack([*(2 / factor * u[:, :2]).T, near - far], axis=1) / (near + far)[:, None]
    exact = ((1 - z + factor**2 * (1 + z)) / (2 * factor)) ** 2
    np.testing.assert_allclose(shrinking(moved, ball, rings=1), exact, rtol=0.05)
    reversed_map = moved * [1, 1, -1]
    np.testing.assert_allclose(shrinking(reversed_map, ball), shrinking(moved, ball), rtol=1e-9)
