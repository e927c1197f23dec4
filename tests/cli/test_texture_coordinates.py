"""Seam and poles of the texture, from several placements of the poles in the triangulation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.mesh import Mesh, require_genus_zero
from gensp.geometry.predicates import map_degree
from gensp.geometry.sphere import icosphere, sample_sphere, unit
from gensp.geometry.texture_coordinates import (
    equirectangular,
    equirectangular_directions,
    split_at_middles,
    unwrap,
)


def placements() -> dict[str, np.ndarray]:
    """Spheres (n, 3) of the icosphere's triangles whose poles lie in all possible ways."""
    ball = icosphere(2)
    centroid = unit(ball.vertices[ball.faces[7]].mean(axis=0, keepdims=True))
    to_pole = Rotation.align_vectors(np.array([[0, 0, 1.0]]), centroid)[0].as_matrix()
    oblique = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    return {
        "vertex": ball.vertices,
        "face": ball.vertices @ to_pole.T,
        "oblique": ball.vertices @ oblique.T,
        "mirrored": ball.vertices * np.array([-1.0, 1, 1]) @ oblique.T,
    }


SPHERES = {name: (u, icosphere(2).faces) for name, u in placements().items()}
# The icosahedron has its poles at the middles of two edges.
SPHERES["edge"] = (icosphere(0).vertices, icosphere(0).faces)


@pytest.mark.parametrize("name", SPHERES)
def test_no_triangle_runs_across_the_picture(name: str) -> None:
    sphere, faces = SPHERES[name]
    cut = unwrap(2 * sphere, sphere, faces)
    u = cut.uv[cut.faces, 0]
    assert np.ptp(u, axis=1).max() < 0.5
    assert u.min() >= 0
    assert u.max() < 1.5


@pytest.mark.parametrize("name", SPHERES)
def test_coordinates_name_the_vertices_place_on_the_sphere(name: str) -> None:
    sphere, faces = SPHERES[name]
    cut = unwrap(2 * sphere, sphere, faces)
    longitude, latitude = 2 * np.pi * cut.uv[:, 0], np.pi * (cut.uv[:, 1] - 0.5)
    level = np.cos(latitude)
    p = np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], 1)
    np.testing.assert_allclose(p, cut.sphere, atol=1e-12)
    np.testing.assert_allclose(unit(cut.vertices), cut.sphere, atol=1e-12)


@pytest.mark.parametrize("name", SPHERES)
def test_the_surface_is_the_same_with_both_poles_as_vertices(name: str) -> None:
    sphere, faces = SPHERES[name]
    cut = unwrap(2 * sphere, sphere, faces)
    whole, place = cut.whole()
    assert whole.euler == 2
    assert abs(map_degree(cut.sphere, cut.faces)) == 1
    np.testing.assert_array_equal(whole.vertices[place], cut.vertices)
    # Every triangle at a pole has a copy of its own, in the middle of its other corners.
    at_pole = np.hypot(*cut.sphere[:, :2].T) < 1e-12
    corner = at_pole[cut.faces]
    assert corner.sum() >= 6
    assert len(np.unique(cut.faces[corner])) == corner.sum()
    triangles = cut.faces[corner.any(axis=1)]
    u, top = cut.uv[triangles, 0], at_pole[triangles]
    np.testing.assert_allclose(u[top], u[~top].reshape(-1, 2).mean(axis=1), atol=1e-12)


def test_picture_and_coordinates_agree() -> None:
    height = 32
    p = equirectangular_directions(height)
    u, v = equirectangular(p.reshape(-1, 3)).T
    row, column = np.divmod(np.arange(2 * height**2), 2 * height)
    np.testing.assert_allclose(u, (column + 0.5) / (2 * height), atol=1e-12)
    np.testing.assert_allclose(1 - v, (row + 0.5) / height, atol=1e-12)


def test_longitude_stays_below_one(rng: np.random.Generator) -> None:
    p = sample_sphere(1000, rng)
    p[0] = unit(np.array([1.0, -1e-300, 0]))
    u = equirectangular(p)[:, 0]
    assert u.min() >= 0
    assert u.max() < 1


@pytest.mark.parametrize("name", SPHERES)
def test_pictures_are_read_at_the_right_place_within_triangles(
    name: str, rng: np.random.Generator
) -> None:
    sphere, faces = SPHERES[name]
    cut = unwrap(sphere, sphere, faces)
    weights = rng.dirichlet(np.ones(3), len(cut.faces))
    seen = np.einsum("kj,kjc->kc", weights, cut.uv[cut.faces])
    true = unit(np.einsum("kj,kjc->kc", weights, cut.sphere[cut.faces]))
    longitude, latitude = 2 * np.pi * seen[:, 0], np.pi * (seen[:, 1] - 0.5)
    level = np.cos(latitude)
    p = np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], 1)
    # The icosahedron's edges are 63 degrees long, those of the others 18.
    assert np.linalg.norm(p - true, axis=1).max() < (0.1 if name == "edge" else 0.03)


def test_split_triangles_cover_the_same_area() -> None:
    ball = icosphere(1)
    sides = np.sort(ball.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    edges, place = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    halved = np.arange(len(edges)) % 2 == 0
    number = np.where(halved, len(ball.vertices) + np.cumsum(halved) - 1, -1)
    faces = split_at_middles(ball.faces, number[place.reshape(-1, 3)])
    points = np.concatenate([ball.vertices, ball.vertices[edges[halved]].mean(axis=1)])
    whole = Mesh(points, faces)
    require_genus_zero(whole)
    assert len(faces) == len(ball.faces) + 2 * halved.sum()
    assert whole.area == pytest.approx(ball.area)
