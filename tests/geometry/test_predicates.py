from fractions import Fraction

import numpy as np
import pytest

from gensp.errors import NotEmbeddable
from gensp.geometry.predicates import (
    _holding,
    bad_faces,
    map_degree,
    spherical_areas,
    spherical_orientation,
)
from gensp.geometry.sphere import icosphere, unit


def exact_sign(a, b, c) -> int:
    (a, b, c) = ([Fraction(float(x)) for x in p] for p in (a, b, c))
    value = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    return (value > 0) - (value < 0)


def test_agrees_with_rational_arithmetic_on_slivers(rng):
    """Triangles within rounding of a great circle, where a floating determinant guesses."""
    a, b = unit(rng.standard_normal((2, 300, 3)))
    weights = rng.random((300, 1))
    c = unit(weights * a + (1 - weights) * b)
    sphere = np.concatenate([a, b, c])
    faces = np.arange(900).reshape(3, 300).T.copy()
    expected = [exact_sign(*sphere[face]) for face in faces]
    np.testing.assert_array_equal(spherical_orientation(sphere, faces), expected)
    rounded = np.sign(np.linalg.det(sphere[faces]))
    assert (rounded != expected).any()


def test_a_folded_vertex_is_found_and_the_degree_stays():
    ball = icosphere(3)
    sphere = ball.vertices.copy()
    # The vertex is pulled across the far edge of its ring.
    sphere[100] = unit(sphere[100] + 0.35 * np.array([1.0, 0.3, -0.2]))
    bad = bad_faces(sphere, ball.faces)
    assert 0 < bad.sum() <= 6
    assert (ball.faces[bad] == 100).any(axis=1).all()
    assert map_degree(sphere, ball.faces) == 1


def test_mirror_image_has_no_bad_face_and_degree_minus_one():
    ball = icosphere(2)
    mirrored = ball.vertices * np.array([1.0, 1.0, -1.0])
    assert not bad_faces(mirrored, ball.faces).any()
    assert map_degree(mirrored, ball.faces) == -1


def test_collapsed_triangle_is_bad():
    ball = icosphere(1)
    sphere = ball.vertices.copy()
    sphere[ball.faces[7, 0]] = sphere[ball.faces[7, 1]]
    assert bad_faces(sphere, ball.faces)[7]


def test_solid_angles_sum_to_the_sphere():
    ball = icosphere(2)
    assert spherical_areas(ball.vertices, ball.faces).sum() == pytest.approx(4 * np.pi)
    octant = np.eye(3)
    assert spherical_areas(octant, np.array([[0, 1, 2]]))[0] == pytest.approx(np.pi / 2)


def double_cover() -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of z → z², which winds twice around the axis."""
    longitude, latitude = np.meshgrid(
        np.arange(48) * 2 * np.pi / 48, np.linspace(-1.4, 1.4, 20), indexing="ij"
    )
    ring = np.stack(
        [
            np.cos(2 * longitude) * np.cos(latitude),
            np.sin(2 * longitude) * np.cos(latitude),
            np.sin(latitude),
        ],
        axis=-1,
    ).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(48), np.arange(19), indexing="ij")
    a, b = (i * 20 + j).ravel(), ((i + 1) % 48 * 20 + j).ravel()
    quads = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    south, north = len(ring), len(ring) + 1
    rim = np.arange(48) * 20
    caps = [
        np.stack([np.full(48, south), np.roll(rim, -1), rim], axis=1),
        np.stack([np.full(48, north), rim + 19, np.roll(rim, -1) + 19], axis=1),
    ]
    sphere = np.concatenate([ring, [[0, 0, -1.0], [0, 0, 1.0]]])
    return sphere, np.concatenate([quads, *caps])


def test_double_cover_has_degree_two():
    assert map_degree(*double_cover()) == 2


@pytest.mark.parametrize("moved", [0, 5, 60, 642])
def test_counted_degree_is_the_signed_area_over_that_of_the_sphere(moved, rng):
    """Folded or not: faces that hold one direction against Gauss's integral."""
    ball = icosphere(3)
    sphere = ball.vertices * rng.choice([-1, 1], 3)
    sphere[:moved] = unit(sphere[:moved] + 0.5 * rng.standard_normal((moved, 3)))
    area = spherical_areas(sphere, ball.faces).sum() / (4 * np.pi)
    assert map_degree(sphere, ball.faces) == pytest.approx(area, abs=1e-9)


@pytest.mark.parametrize("level", [0, 1])
def test_a_direction_on_a_border_is_not_counted(level):
    """The axis is in the middle of an edge of the icosahedron, and a vertex one level finer."""
    ball = icosphere(level)
    outward = np.ones(len(ball.faces), dtype=np.int64)
    assert _holding(np.array([0, 1.0, 0]), ball.vertices, ball.faces, outward) is None
    inside = ball.vertices[ball.faces[11]].sum(axis=0)
    assert _holding(inside, ball.vertices, ball.faces, outward).tolist() == [11]


def test_degree_needs_unit_vectors():
    ball = icosphere(1)
    with pytest.raises(NotEmbeddable):
        map_degree(2 * ball.vertices, ball.faces)
