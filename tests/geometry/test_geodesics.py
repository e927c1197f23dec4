"""Geodesic distances: known ways on the sphere and on a cube, and those of another program."""

import igl
import numpy as np
import pytest

from gensp.geometry.geodesics import geodesic_distances
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import icosphere, unit


def _random_points(mesh: Mesh, count: int) -> tuple[SurfacePoints, SurfacePoints]:
    generator = np.random.default_rng(0)
    return (
        sample_surface(mesh.face_areas, count, generator),
        sample_surface(mesh.face_areas, count, generator),
    )


def test_ways_on_the_sphere_are_arcs() -> None:
    ball = icosphere(4)
    a, b = _random_points(ball, 200)
    p, q = (unit(points.on(ball.vertices, ball.faces)) for points in (a, b))
    arcs = np.arccos(np.clip(np.einsum("ki,ki->k", p, q), -1, 1))
    np.testing.assert_allclose(geodesic_distances(ball, a, b), arcs, rtol=0.012)


def test_ways_over_one_edge_of_a_cube_are_those_of_the_unfolded_cube() -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    # The sides x = 1, as triangles with the diagonal 4-7, and z = 1, with 1-7, meet along 5-7.
    faces = np.array([[4, 6, 7], [4, 7, 5], [1, 5, 7], [1, 7, 3]])
    a = SurfacePoints(np.array([1]), np.array([[0.2, 0.3, 0.5]]))
    b = SurfacePoints(np.array([2]), np.array([[0.2, 0.5, 0.3]]))
    one, other = (points.on(corners, faces)[0] for points in (a, b))
    way = np.hypot(one[1] - other[1], (1 - one[2]) + (1 - other[0]))
    np.testing.assert_allclose(geodesic_distances(Mesh(corners, faces), a, b), [way], rtol=1e-12)


def test_agrees_with_the_exact_ways_of_libigl(bumpy: Mesh) -> None:
    ids = np.random.default_rng(1).choice(len(bumpy.vertices), (60, 2), replace=False)
    points = [_at_vertices(bumpy, column) for column in ids.T]
    exact = [
        float(igl.exact_geodesic(bumpy.vertices, bumpy.faces, VS=ids[k, :1], VT=ids[k, 1:])[0])
        for k in range(len(ids))
    ]
    found = geodesic_distances(bumpy, *points)
    np.testing.assert_allclose(found, exact, rtol=0.03)
    assert np.abs(found / exact - 1).mean() < 0.01


def test_within_a_face_and_in_both_directions(bumpy: Mesh) -> None:
    a, b = _random_points(bumpy, 50)
    same = SurfacePoints(a.faces, b.barycentric)
    straight = np.linalg.norm(
        a.on(bumpy.vertices, bumpy.faces) - same.on(bumpy.vertices, bumpy.faces), axis=1
    )
    np.testing.assert_allclose(geodesic_distances(bumpy, a, same), straight, rtol=1e-12)
    there, back = geodesic_distances(bumpy, a, b), geodesic_distances(bumpy, b, a)
    np.testing.assert_allclose(there, back, rtol=0.03)
    assert (there >= _chord(bumpy, a, b) * (1 - 1e-12)).all()


def _chord(mesh: Mesh, a: SurfacePoints, b: SurfacePoints) -> np.ndarray:
    difference = a.on(mesh.vertices, mesh.faces) - b.on(mesh.vertices, mesh.faces)
    return np.linalg.norm(difference, axis=1)


def _at_vertices(mesh: Mesh, ids: np.ndarray) -> SurfacePoints:
    corners = mesh.faces.reshape(-1)
    place = np.array([np.flatnonzero(corners == v)[0] for v in ids])
    return SurfacePoints(place // 3, np.eye(3)[place % 3])


def test_parts_that_no_way_joins_are_infinitely_far(bumpy: Mesh) -> None:
    n = len(bumpy.vertices)
    two = Mesh(
        np.concatenate([bumpy.vertices, bumpy.vertices + 5]),
        np.concatenate([bumpy.faces, bumpy.faces + n]),
    )
    a, b = _random_points(bumpy, 3)
    other = SurfacePoints(b.faces + len(bumpy.faces), b.barycentric)
    assert np.isinf(geodesic_distances(two, a, other)).all()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scales_with_the_surface(bumpy: Mesh, scale: float) -> None:
    a, b = _random_points(bumpy, 30)
    scaled = Mesh(scale * bumpy.vertices, bumpy.faces)
    expected = scale * geodesic_distances(bumpy, a, b)
    np.testing.assert_allclose(geodesic_distances(scaled, a, b), expected, rtol=1e-9)
