"""Obj files as they come: groups, materials, textures, normals, polygons, negative indices."""

from pathlib import Path

import numpy as np
import pytest

from gensp.errors import UnreadableMesh
from gensp.geometry.mesh import load_mesh, require_genus_zero
from gensp.geometry.sphere import icosphere


def test_groups_materials_and_texture_seams_do_not_cut_the_surface(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    ball = icosphere(2)
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in ball.vertices]
    lines += [f"vt {u:.3f} {v:.3f}" for u, v in rng.random((50, 2))]
    lines += ["vn 0 0 1", "o one", "g a", "usemtl red"]
    for number, face in enumerate(ball.faces + 1):
        if number == 100:
            lines += ["o two", "g b", "usemtl blue", "s off"]
        seam = rng.integers(1, 51, 3)
        style = ("{0}", "{0}/{1}", "{0}//1", "{0}/{1}/1")[number % 4]
        lines.append("f " + " ".join(style.format(*pair) for pair in zip(face, seam, strict=True)))
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    mesh = load_mesh(tmp_path / "ball.obj")
    require_genus_zero(mesh)
    assert np.array_equal(mesh.vertices, ball.vertices)
    assert np.array_equal(mesh.faces, ball.faces)


def test_polygons_and_negative_indices(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    lines = [f"v {x} {y} {z} 0.5 0.5 0.5" for x, y, z in corners]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines += ["f " + " ".join(str(v) for v in quad) for quad in quads[:3]]
    lines += ["f " + " ".join(str(v - 9) for v in quad) for quad in quads[3:]]
    (tmp_path / "cube.obj").write_text("# a cube\n" + "\n".join(lines) + "\n")
    mesh = load_mesh(tmp_path / "cube.obj")
    require_genus_zero(mesh)
    assert mesh.area == pytest.approx(6)


def test_faces_without_their_vertices_are_an_error(tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    with pytest.raises(UnreadableMesh, match=r"bad\.obj: cannot be read .*outside the 3"):
        load_mesh(tmp_path / "bad.obj")


def test_lines_that_go_on_are_joined(tmp_path: Path) -> None:
    """A backslash ends vertices and faces that go on; the path of a comment ends with one too."""
    text = "# C:\\models\\\nv 0 0 0\nv 1 0 \\\n0\nv 1 1 0\nv 0 1 0\nf 1 2 \\\n3 \\\n4\n"
    (tmp_path / "quad.obj").write_text(text)
    mesh = load_mesh(tmp_path / "quad.obj")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.vertices[1].tolist() == [1, 0, 0]
