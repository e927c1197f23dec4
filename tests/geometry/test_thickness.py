"""Balls that touch a surface from inside."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.geometry.thickness import medial_ball_radii


def test_balls_of_a_sphere_are_the_sphere() -> None:
    ball = icosphere(3)
    assert medial_ball_radii(Mesh(3 * ball.vertices, ball.faces)) == pytest.approx(3, rel=0.15)


def test_balls_of_a_spheroid_are_small_at_its_tips_and_as_large_as_its_waist() -> None:
    # x²/a² + y²/b² + z²/b² = 1: radius of curvature b²/a at the tips, waist of radius b.
    ball, a, b = icosphere(4), 3.0, 1.0
    spheroid = Mesh(ball.vertices * [a, b, b], ball.faces)
    radii = medial_ball_radii(spheroid)
    along = np.abs(spheroid.vertices[:, 0])
    assert radii[along.argmax()] == pytest.approx(b * b / a, rel=0.15)
    assert radii[along < 0.05] == pytest.approx(b, rel=0.15)


def test_no_other_vertex_lies_inside_a_ball(bumpy: Mesh) -> None:
    radii = medial_ball_radii(bumpy)
    middles = bumpy.vertices - radii[:, None] * bumpy.vertex_normals
    assert (cdist(middles, bumpy.vertices).min(axis=1) >= radii * (1 - 1e-6)).all()


def test_turning_and_scaling_change_nothing_else(bumpy: Mesh) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    moved = Mesh(2 * bumpy.vertices @ turn.T + 5, bumpy.faces)
    assert medial_ball_radii(moved) == pytest.approx(2 * medial_ball_radii(bumpy), rel=1e-6)


def test_a_flat_triangle_touches_nothing() -> None:
    ball = icosphere(2)
    vertices = ball.vertices.copy()
    a, b, c = ball.faces[0]
    vertices[c] = (vertices[a] + vertices[b]) / 2
    assert np.isfinite(medial_ball_radii(Mesh(vertices, ball.faces))).all()
