import numpy as np
import pytest
import trimesh

from gensp.errors import DegenerateMesh, NotGenusZero, UnreadableMesh
from gensp.geometry.mesh import Mesh, load_mesh, normalize, require_genus_zero, save_mesh, simplify
from gensp.geometry.sphere import icosphere


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_file_round_trip_keeps_the_vertex_order(tmp_path, bumpy, suffix):
    save_mesh(bumpy, tmp_path / f"shape{suffix}")
    loaded = load_mesh(tmp_path / f"shape{suffix}")
    np.testing.assert_allclose(loaded.vertices, bumpy.vertices, atol=1e-6)
    np.testing.assert_array_equal(loaded.faces, bumpy.faces)
    assert loaded.name == "shape"


def test_stl_is_welded(tmp_path, bumpy):
    save_mesh(bumpy, tmp_path / "shape.stl")
    loaded = load_mesh(tmp_path / "shape.stl")
    assert len(loaded.vertices) == len(bumpy.vertices)
    require_genus_zero(loaded)


def test_normalize_known_answer_and_invariance(bumpy):
    normal = normalize(bumpy)
    assert normal.area == pytest.approx(4 * np.pi)
    moved = normalize(bumpy.with_vertices(3 * bumpy.vertices + np.array([1.0, -2.0, 5.0])))
    np.testing.assert_allclose(moved.vertices, normal.vertices, atol=1e-12)


def test_tetrahedron_quantities():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(vertices, faces)
    assert mesh.euler == 2
    assert len(mesh.edges) == 6
    assert mesh.area == pytest.approx(1.5 + np.sqrt(3) / 2)
    require_genus_zero(mesh)


def test_simplify_keeps_a_closed_genus_zero_surface(bumpy):
    coarse = simplify(bumpy, 200)
    require_genus_zero(coarse)
    assert len(coarse.vertices) == 200
    assert coarse.area == pytest.approx(bumpy.area, rel=0.05)
    assert simplify(bumpy, 10_000) is bumpy


def torus() -> Mesh:
    solid = trimesh.creation.torus(1.0, 0.3, major_sections=12, minor_sections=8)
    return Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int64), "torus")


def two_balls() -> Mesh:
    ball = icosphere(1)
    vertices = np.concatenate([ball.vertices, ball.vertices + 3])
    return Mesh(vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)]), "two")


BALL = icosphere(1)
NAN = BALL.vertices.copy()
NAN[3, 1] = np.nan
FLAT = BALL.vertices.copy()
FLAT[BALL.faces[0, 0]] = FLAT[BALL.faces[0, 1]]
ONE_TURNED = BALL.faces.copy()
ONE_TURNED[0] = ONE_TURNED[0, ::-1]
FIN = np.concatenate([BALL.faces, [[BALL.faces[0, 0], BALL.faces[0, 1], 20]]])


@pytest.mark.parametrize(
    ("mesh", "error", "found"),
    [
        (Mesh(BALL.vertices, BALL.faces[1:], "open"), NotGenusZero, "3 boundary edges"),
        (Mesh(BALL.vertices, FIN, "fin"), NotGenusZero, "non-manifold"),
        (Mesh(BALL.vertices, ONE_TURNED, "turned"), NotGenusZero, "disagree in orientation"),
        (Mesh(BALL.vertices, BALL.faces[:, ::-1].copy(), "inside"), NotGenusZero, "look inwards"),
        (two_balls(), NotGenusZero, "2 connected components"),
        (torus(), NotGenusZero, "genus 1"),
        (Mesh(NAN, BALL.faces, "nan"), DegenerateMesh, "1 vertices are not finite"),
        (Mesh(FLAT, BALL.faces, "flat"), DegenerateMesh, "triangles without area"),
        (Mesh(BALL.vertices[:3], np.array([[0, 1, 2]]), "one"), DegenerateMesh, "1 faces"),
        (Mesh(BALL.vertices, BALL.faces + 9, "index"), DegenerateMesh, "names vertex"),
    ],
)
def test_each_defect_has_its_own_line(mesh, error, found):
    with pytest.raises(error, match=found) as caught:
        require_genus_zero(mesh)
    text = str(caught.value)
    assert text.startswith(mesh.name)
    assert "\n" not in text
    assert "on_bad" not in text


def test_too_large_names_the_limit():
    with pytest.raises(DegenerateMesh, match="80 faces; at most 50"):
        require_genus_zero(BALL, max_faces=50)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.ply", b""),
        ("noise.ply", b"ply\nformat ascii 1.0\nelement vertex three\n"),
        ("noise.off", b"OFF\n3 1 0\n0 0 0\n"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n"),
        ("shape.xyz", b"0 0 0\n"),
    ],
)
def test_unreadable_files(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnreadableMesh, match=name):
        load_mesh(path)


def test_missing_file(tmp_path):
    with pytest.raises(UnreadableMesh, match="does not exist"):
        load_mesh(tmp_path / "none.ply")
