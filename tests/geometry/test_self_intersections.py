import numpy as np

from gensp.geometry.mesh import Mesh
from gensp.geometry.self_intersections import self_intersecting_faces
from gensp.geometry.sphere import icosphere


def joined(*parts: Mesh) -> Mesh:
    counts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + first for part, first in zip(parts, counts, strict=False)]
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def test_two_balls_cross_along_a_circle() -> None:
    ball = icosphere(3)
    moved = ball.with_vertices(ball.vertices + np.array([1.0, 0.1, 0.05]))
    marks = self_intersecting_faces(joined(ball, moved))
    centres = joined(ball, moved).vertices[joined(ball, moved).faces[marks]].mean(axis=1)
    # The circle lies in the middle plane between both centres.
    middle = np.array([1.0, 0.1, 0.05]) / 2
    off = (centres - middle) @ middle / np.linalg.norm(middle)
    assert marks.sum() > 40
    assert np.abs(off).max() < 0.2
    apart = ball.with_vertices(ball.vertices + 3)
    assert not self_intersecting_faces(joined(ball, apart)).any()


def test_embedded_surfaces_and_broken_corners(bumpy: Mesh) -> None:
    assert not self_intersecting_faces(bumpy).any()
    spoilt = np.array(bumpy.vertices)
    spoilt[5] = np.nan
    assert not self_intersecting_faces(bumpy.with_vertices(spoilt)).any()
    assert len(self_intersecting_faces(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)))) == 0


def test_a_pushed_vertex_crosses_the_far_side() -> None:
    ball = icosphere(2)
    pushed = np.array(ball.vertices)
    pushed[3] = -1.5 * pushed[3]
    marks = self_intersecting_faces(ball.with_vertices(pushed))
    around = (ball.faces == 3).any(axis=1)
    assert marks[around].any()
    assert marks[~around].any()


def test_copies_of_a_face_count_and_are_not_paired_with_each_other() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [6, 5, 5], [5, 6, 5]])
    faces = np.array([[0, 1, 2]] * 20_000 + [[3, 4, 5]])
    marks = self_intersecting_faces(Mesh(corners, faces))
    assert marks[:-1].all()
    assert not marks[-1]
