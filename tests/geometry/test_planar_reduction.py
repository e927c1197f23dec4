"""The way through the plane: derivatives, Tutte's embedding, maps whose distortion is known."""

import numpy as np
import pytest

from gensp.errors import NotEmbeddable
from gensp.geometry.assembly import HessianPattern
from gensp.geometry.composed_dirichlet import ComposedDirichlet
from gensp.geometry.distortion import distortion
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.planar_reduction import (
    balanced,
    faces_by_regularity,
    inverse_stereographic,
    planar_map,
    removable_face,
    tutte_in_triangle,
)
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.sphere import icosphere


def first_face(mesh: Mesh) -> int:
    return int(faces_by_regularity(mesh)[0])


def without(mesh: Mesh, face: int) -> Mesh:
    return Mesh(mesh.vertices, np.delete(mesh.faces, face, axis=0), mesh.name)


@pytest.fixture
def shape(ellipsoid: Mesh) -> Mesh:
    return normalize(ellipsoid)


@pytest.fixture
def embedded(shape: Mesh) -> tuple[Mesh, np.ndarray]:
    """The open mesh and a planar map without folds."""
    outer = first_face(shape)
    rest = without(shape, outer)
    return rest, balanced(tutte_in_triangle(shape, outer), rest.faces, rest.face_areas)


def signed_areas(z: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (z[faces[:, k]] for k in range(3))
    return np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2] / 2


def test_energy_is_that_of_the_composed_singular_values(embedded):
    mesh, z = embedded
    corners, images = mesh.vertices[mesh.faces], z[mesh.faces]
    source = (corners[:, 1:] - corners[:, :1]).swapaxes(1, 2)
    plane = np.linalg.qr(source)[1]
    jacobian = (images[:, 1:] - images[:, :1]).swapaxes(1, 2) @ np.linalg.inv(plane)
    factor = 2 / (1 + np.sum(images.mean(axis=1) ** 2, axis=1))
    values = factor[:, None] * np.linalg.svd(jacobian, compute_uv=False)
    expected = mesh.face_areas @ np.sum(values**2 + values**-2.0, axis=1)
    assert ComposedDirichlet(mesh).energy(z) == pytest.approx(expected, rel=1e-10)


def test_derivatives_are_differences(embedded, rng):
    mesh, z = embedded
    energy, step = ComposedDirichlet(mesh), 1e-6
    gradient, blocks = energy.derivatives(z)
    hessian = HessianPattern(mesh.faces, len(z)).assemble(blocks, np.zeros(z.size))
    moved = 0.01 * rng.standard_normal(z.shape)
    ahead, back = z + step * moved, z - step * moved
    slope = (energy.energy(ahead) - energy.energy(back)) / (2 * step)
    assert slope == pytest.approx(gradient @ moved.reshape(-1), rel=1e-5)
    change = (energy.derivatives(ahead)[0] - energy.derivatives(back)[0]) / (2 * step)
    expected = hessian @ moved.reshape(-1)
    assert np.linalg.norm(change - expected) < 1e-5 * np.linalg.norm(expected)


def test_folded_plane_has_infinite_energy(embedded):
    mesh, z = embedded
    assert ComposedDirichlet(mesh).energy(z * np.array([1, -1])) == np.inf


def test_tuttes_embedding_folds_nothing_and_fills_its_triangle(limbed):
    outer = first_face(limbed)
    z = tutte_in_triangle(limbed, outer)
    rest = without(limbed, outer)
    assert (signed_areas(z, rest.faces) > 0).all()
    assert signed_areas(z, rest.faces).sum() == pytest.approx(3 * np.sqrt(3) / 4)


def test_balanced_hemispheres_have_the_same_area(embedded):
    mesh, z = embedded
    north = inverse_stereographic(z[mesh.faces].mean(axis=1))[:, 2] > 0
    assert mesh.face_areas[north].sum() == pytest.approx(mesh.area / 2, rel=0.01)


def test_projection_is_conformal_and_meets_the_poles(rng):
    z, step = rng.standard_normal((20, 2)), 1e-6
    moved = [inverse_stereographic(z + step * axis) for axis in np.eye(2)]
    tangents = (np.stack(moved) - inverse_stereographic(z)) / step
    factor = 2 / (1 + np.sum(z**2, axis=1))
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=2), [factor, factor], rtol=1e-4)
    np.testing.assert_allclose(np.sum(tangents[0] * tangents[1], axis=1), 0, atol=1e-4)
    np.testing.assert_allclose(inverse_stereographic(np.zeros((1, 2))), [[0, 0, 1]])
    np.testing.assert_allclose(
        inverse_stereographic(np.array([[1e9, 0]])), [[0, 0, -1]], atol=1e-8
    )


def test_most_regular_face_is_the_equilateral_one():
    ball = icosphere(1)
    vertices = ball.vertices * np.array([1, 2, 3])
    corners = vertices[ball.faces[7]]
    middle = corners.mean(axis=0)
    angles = 2 * np.pi / 3 * np.arange(3)
    first, second = np.linalg.qr((corners - middle)[:2].T)[0].T
    vertices[ball.faces[7]] = (
        middle + np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)
    )
    assert first_face(Mesh(vertices, ball.faces)) == 7


def test_ball_is_mapped_almost_isometrically():
    ball = normalize(icosphere(3))
    found = planar_map(ball, first_face(ball))
    sphere = inverse_stereographic(found.plane)
    assert found.converged
    assert not bad_faces(sphere, ball.faces).any()
    assert map_degree(sphere, ball.faces) == 1
    assert distortion(ball.vertices, sphere, ball.faces).mean < 1.02


def test_energy_of_the_optimum_is_below_the_starts(shape, embedded):
    mesh, z = embedded
    found = planar_map(shape, first_face(shape))
    energy = ComposedDirichlet(mesh)
    assert found.energy == pytest.approx(energy.energy(found.plane))
    assert found.energy < 0.9 * energy.energy(z)
    # No map has less than an isometry's four times the area.
    assert found.energy > 4 * mesh.area


def test_removable_face_is_the_first_unless_nothing_can_be_embedded(shape, monkeypatch):
    assert removable_face(shape) == first_face(shape)
    flat = shape.with_vertices(shape.vertices, "crowded")
    monkeypatch.setattr(
        "gensp.geometry.planar_reduction.tutte_in_triangle",
        lambda mesh, outer: 1e-30 * np.round(mesh.vertices[:, :2]),
    )
    with pytest.raises(NotEmbeddable, match=r"crowded: .* 3 most regular faces.*another method"):
        removable_face(flat, attempts=3)
    with pytest.raises(NotEmbeddable, match=r"inside face 5 .*remove another face"):
        planar_map(flat, 5)
