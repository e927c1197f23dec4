from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.errors import UnreadableMesh
from gensp.files import save_npz
from gensp.geometry.mesh import load_mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.sphere import icosphere, sample_sphere, unit
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map


@pytest.fixture
def squeezed(bumpy) -> SphericalMap:
    """A bijective map with area ratios of several hundred."""
    sphere = unit(icosphere(3).vertices * np.array([1.0, 1.0, 0.03]))
    return SphericalMap(sphere, bumpy.vertices, bumpy.faces, "squeezed")


def test_locate_inverts_to_sphere(squeezed, rng):
    points = sample_surface(squeezed.mesh.face_areas, 3000, rng)
    again = squeezed.locate(squeezed.to_sphere(points))
    np.testing.assert_allclose(
        again.on(squeezed.surface, squeezed.faces),
        points.on(squeezed.surface, squeezed.faces),
        atol=1e-9,
    )


def test_to_sphere_inverts_locate(squeezed, rng):
    p = sample_sphere(3000, rng)
    np.testing.assert_allclose(squeezed.to_sphere(squeezed.locate(p)), p, atol=1e-12)


def test_location_agrees_with_brute_force(squeezed, rng):
    p = sample_sphere(100, rng)
    corners = squeezed.sphere[squeezed.faces]
    weights = np.linalg.solve(corners.transpose(0, 2, 1)[None], p[:, None, :, None])[..., 0]
    brute = weights.min(axis=2).argmax(axis=1)
    np.testing.assert_array_equal(squeezed.locate(p).faces, brute)


def test_remesh_of_the_identity_is_the_identity():
    ball = icosphere(3)
    same = SphericalMap(ball.vertices, ball.vertices, ball.faces)
    np.testing.assert_allclose(same.icosphere_remesh(3).vertices, ball.vertices, atol=1e-12)


def test_rotation_commutes(squeezed, rng):
    rotation = Rotation.random(random_state=3).as_matrix()
    p = sample_sphere(500, rng)
    np.testing.assert_allclose(
        squeezed.rotated(rotation).to_surface(p @ rotation.T), squeezed.to_surface(p), atol=1e-9
    )


def test_bijective_map_is_certified(squeezed):
    assert not squeezed.bad_faces().any()
    assert squeezed.degree() == 1


def test_files_keep_every_bit(tmp_path, squeezed):
    save_map(squeezed, tmp_path)
    again = load_map(tmp_path / "squeezed.npz")
    np.testing.assert_array_equal(again.sphere, squeezed.sphere)
    np.testing.assert_array_equal(again.surface, squeezed.surface)
    assert again.sphere.dtype == np.float64
    assert again.faces.dtype == np.int64
    raw = (tmp_path / "squeezed.ply").read_bytes()
    body = raw[raw.index(b"end_header\n") + len(b"end_header\n") :]
    doubles = np.frombuffer(body, "<f8", 6 * len(again.sphere)).reshape(-1, 6)
    np.testing.assert_array_equal(doubles[:, 3:], squeezed.sphere)
    mesh = load_mesh(tmp_path / "squeezed.ply")
    np.testing.assert_array_equal(mesh.faces, squeezed.faces)
    np.testing.assert_array_equal(mesh.vertices, squeezed.surface)


def test_the_file_keeps_the_rung(tmp_path, squeezed):
    save_map(replace(squeezed, diagnostics={"rung": "untangled", "seconds": 1.0}), tmp_path)
    assert load_map(tmp_path / "squeezed.npz").diagnostics == {"rung": "untangled"}


def test_incomplete_file_is_named(tmp_path):
    save_npz(tmp_path / "half.npz", vertices=np.zeros((3, 3)))
    with pytest.raises(UnreadableMesh, match=r"half\.npz: arrays faces, sphere are missing"):
        load_map(tmp_path / "half.npz")


def test_what_is_printed_is_one_line(squeezed):
    n, m = len(squeezed.sphere), len(squeezed.faces)
    assert repr(squeezed) == f"SphericalMap('{squeezed.name}', {n} vertices, {m} faces)"
    assert repr(squeezed.mesh) == f"Mesh('{squeezed.name}', {n} vertices, {m} faces)"
