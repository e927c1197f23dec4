"""Registration by rotation: known rotations, brute force, invariance."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.alignment import ball_inversion, moebius_center
from gensp.geometry.harmonics import angular_momentum, rotation_of
from gensp.geometry.mesh import Mesh
from gensp.geometry.rotation_registration import (
    density_signal,
    refine_rotation,
    register_rotation,
    rotation_correlation,
)
from gensp.geometry.sphere import icosphere, unit

LIMIT = 12
TURN = Rotation.from_rotvec([1.2, -2.0, 0.7]).as_matrix()
MIRROR = TURN @ np.diag([1.0, 1.0, -1.0])


@pytest.fixture
def lopsided() -> Mesh:
    """A sphere with bumps, no two directions of which look alike, nor mirrored ones."""
    ball = icosphere(3)
    x, y, z = ball.vertices.T
    radius = 1 + 0.3 * np.sin(2 * x + 1) * y + 0.2 * z * x + 0.1 * y**3 + 0.15 * np.cos(3 * z + y)
    return Mesh(ball.vertices * radius[:, None], ball.faces, "lopsided")


def signal(mesh: Mesh, turn: np.ndarray | None = None, limit: int = LIMIT) -> np.ndarray:
    sphere = icosphere(3).vertices @ (np.eye(3) if turn is None else turn.T)
    return density_signal(sphere, mesh.faces, mesh.face_areas, bandlimit=limit)


@pytest.mark.parametrize("limit", [12, 24])
def test_known_rotation_of_the_same_map_is_found(lopsided, limit):
    a, b = signal(lopsided, limit=limit), signal(lopsided, TURN, limit)
    best, *others = register_rotation(a, b)
    assert np.linalg.norm(best.rotation - TURN) < 1e-6
    assert best.correlation == pytest.approx(1, abs=1e-9)
    assert all(other.correlation < 0.98 for other in others)


def test_known_moebius_map_is_found_after_centring(lopsided):
    faces, areas, ball = lopsided.faces, lopsided.face_areas, icosphere(3).vertices
    moved = ball_inversion(ball @ TURN.T, np.array([0.3, 0.2, -0.4]))
    first, second = (moebius_center(sphere, faces, areas) for sphere in (ball, moved))
    a, b = (density_signal(sphere, faces, areas) for sphere in (first, second))
    best = register_rotation(a, b)[0]
    # Chords are no arcs, so the centred maps themselves agree to the size of the triangles only.
    np.testing.assert_allclose(first @ best.rotation.T, second, atol=1e-2)
    assert best.correlation > 0.999


def test_reflection_is_found_where_it_is_asked_for(lopsided):
    a, b = signal(lopsided), signal(lopsided, MIRROR)
    best = register_rotation(a, b, reflection=True)[0]
    assert np.linalg.norm(best.rotation - MIRROR) < 1e-6
    proper = register_rotation(a, b)[0]
    assert np.linalg.det(proper.rotation) == pytest.approx(1)
    assert proper.correlation < best.correlation - 0.01


def test_transform_agrees_with_turned_coefficients(lopsided, ellipsoid):
    a, b, samples = signal(lopsided), signal(ellipsoid), 2 * LIMIT
    values = rotation_correlation(a, b, samples)
    generator = np.random.default_rng(3)
    for index in generator.integers(samples, size=(20, 3)):
        angles = 2 * np.pi / samples * index[:, None]
        turned = angular_momentum(LIMIT).rotated(a, rotation_of(*angles)[0])
        assert values[tuple(index)] == pytest.approx(np.vdot(b, turned).real, abs=1e-12)


def test_imaginary_parts_add_a_second_correlation(lopsided, ellipsoid):
    first, second = signal(lopsided), signal(lopsided, TURN)
    other = signal(ellipsoid), signal(ellipsoid, MIRROR)
    both = rotation_correlation(first + 1j * other[0], second + 1j * other[1], 2 * LIMIT)
    apart = [rotation_correlation(a, b, 2 * LIMIT) for a, b in ((first, second), other)]
    np.testing.assert_allclose(both, sum(apart), atol=1e-12)


def test_no_random_rotation_correlates_more(lopsided, ellipsoid):
    a, b = signal(lopsided), signal(ellipsoid)
    best = register_rotation(a, b)[0]
    scale = np.linalg.norm(a) * np.linalg.norm(b)
    momentum = angular_momentum(LIMIT)
    tried = [
        np.vdot(b, momentum.rotated(a, rotation)).real / scale
        for rotation in Rotation.random(500, random_state=4).as_matrix()
    ]
    assert max(tried) <= best.correlation
    assert max(tried) > 0.5 * best.correlation


def test_candidates_of_an_ellipsoid_are_its_half_turns(ellipsoid):
    found = register_rotation(signal(ellipsoid), signal(ellipsoid, TURN), candidates=4)
    assert [one.correlation for one in found] == pytest.approx([1, 1, 1, 1], abs=1e-9)
    halves = [np.diag(signs) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    for half in halves:
        assert min(np.linalg.norm(one.rotation - TURN @ half) for one in found) < 1e-6


def test_candidates_are_separated_maxima_in_order(lopsided):
    a, b = signal(lopsided), signal(lopsided, TURN)
    found = register_rotation(a, b, separation=0.6)
    values = [one.correlation for one in found]
    assert values == sorted(values, reverse=True)
    assert len(found) > 1
    scale = np.linalg.norm(a) * np.linalg.norm(b)
    nudge = Rotation.from_rotvec([1e-3, -2e-3, 1e-3]).as_matrix()
    for i, one in enumerate(found):
        for other in found[:i]:
            assert Rotation.from_matrix(one.rotation @ other.rotation.T).magnitude() > 0.6
        nudged = angular_momentum(LIMIT).rotated(a, one.rotation @ nudge)
        assert np.vdot(b, nudged).real / scale < values[i]


def test_refinement_climbs_from_the_neighbourhood(lopsided):
    a, b = signal(lopsided), signal(lopsided, TURN)
    near = Rotation.from_rotvec([0.1, -0.1, 0.05]).as_matrix() @ TURN
    assert np.linalg.norm(refine_rotation(a, b, near).rotation - TURN) < 1e-9


def test_turning_both_maps_turns_the_result(lopsided):
    other = Rotation.from_rotvec([-0.4, 0.9, 2.0]).as_matrix()
    longer = lopsided.with_vertices(lopsided.vertices * np.array([1.1, 1, 1]))
    plain = register_rotation(signal(lopsided), signal(longer))[0]
    turned = register_rotation(signal(lopsided, TURN), signal(longer, other))[0]
    np.testing.assert_allclose(turned.rotation, other @ plain.rotation @ TURN.T, atol=1e-5)
    assert turned.correlation == pytest.approx(plain.correlation, abs=1e-6)


def test_signal_hardly_depends_on_the_triangulation(lopsided):
    # Every triangle is split at its centroid, on the surface and on the sphere.
    ball, corners = icosphere(3).vertices, lopsided.faces
    centre = len(ball) + np.arange(len(corners))
    sides = (corners[:, [k, (k + 1) % 3]] for k in range(3))
    faces = np.concatenate([np.column_stack([side, centre]) for side in sides])
    finer = np.concatenate([lopsided.vertices, lopsided.vertices[corners].mean(axis=1)])
    sphere = np.concatenate([ball, unit(ball[corners].mean(axis=1))])
    areas = Mesh(finer, faces).face_areas
    split, plain = density_signal(sphere, faces, areas, bandlimit=LIMIT), signal(lopsided)
    assert np.linalg.norm(split - plain) < 0.02 * np.linalg.norm(plain)


def test_even_density_has_no_rotation_to_find(lopsided):
    even = np.zeros((LIMIT, 2 * LIMIT - 1), dtype=complex)
    found = register_rotation(even, signal(lopsided))
    assert len(found) == 1
    assert found[0].correlation == 0
    np.testing.assert_array_equal(found[0].rotation, np.eye(3))
