"""Every kind of bad input is reported in one line: file, found, required, remedy."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gensp.data.shapes import ShapeCollection
from gensp.errors import BadMesh, MissingData, Unsupported
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.geometry.sphere import icosphere

BALL = icosphere(2)


def _write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    save_mesh(Mesh(np.array(vertices), np.array(faces)), path)


def _open(path: Path) -> None:
    _write(path, BALL.vertices, BALL.faces[1:])


def _non_manifold(path: Path) -> None:
    apex = np.concatenate([BALL.vertices, [[3.0, 0, 0]]])
    a, b, _ = BALL.faces[0]
    _write(path, apex, np.concatenate([BALL.faces, [[a, b, len(BALL.vertices)]]]))


def _pinched(path: Path) -> None:
    second = np.where(BALL.faces == 0, 0, BALL.faces + len(BALL.vertices) - 1)
    beside = BALL.vertices[1:] + 2.5 * BALL.vertices[0]
    vertices = np.concatenate([BALL.vertices, beside])
    _write(path, vertices, np.concatenate([BALL.faces, second]))


def _flipped(path: Path) -> None:
    faces = BALL.faces.copy()
    faces[5] = faces[5, ::-1]
    _write(path, BALL.vertices, faces)


def _inside_out(path: Path) -> None:
    _write(path, BALL.vertices, BALL.faces[:, ::-1])


def _two_parts(path: Path) -> None:
    vertices = np.concatenate([BALL.vertices, BALL.vertices + 5])
    _write(path, vertices, np.concatenate([BALL.faces, BALL.faces + len(BALL.vertices)]))


def _torus(path: Path) -> None:
    n, k = 24, 12
    i, j = np.meshgrid(np.arange(n), np.arange(k), indexing="ij")
    u, v = 2 * np.pi * i / n, 2 * np.pi * j / k
    ring = 2 + 0.5 * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), 0.5 * np.sin(v)], axis=-1)
    a, b = i * k + j, (i + 1) % n * k + j
    c, d = (i + 1) % n * k + (j + 1) % k, i * k + (j + 1) % k
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    _write(path, vertices.reshape(-1, 3), faces)


def _nan(path: Path) -> None:
    vertices = BALL.vertices.copy()
    vertices[7] = np.nan
    _write(path, vertices, BALL.faces)


def _zero_area(path: Path) -> None:
    vertices = BALL.vertices.copy()
    a, b, c = BALL.faces[3]
    vertices[c] = (vertices[a] + vertices[b]) / 2
    vertices[[a, b, c]] *= 4.0
    vertices[c] = vertices[a]
    _write(path, vertices, BALL.faces)


def _flat(path: Path) -> None:
    _write(path, np.zeros_like(BALL.vertices), BALL.faces)


def _empty_file(path: Path) -> None:
    path.write_bytes(b"")


def _no_triangles(path: Path) -> None:
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n"
    )


def _garbage(path: Path) -> None:
    path.write_bytes(b"ply\nthis is no header\x00\xff" * 20)


def _truncated(path: Path) -> None:
    _write(path, BALL.vertices, BALL.faces)
    path.write_bytes(path.read_bytes()[:-200])


def _one_triangle(path: Path) -> None:
    _write(path, np.eye(3), np.array([[0, 1, 2]]))


def _too_many_faces(path: Path) -> None:
    big = icosphere(7)
    _write(path, big.vertices, big.faces)


def _stray_vertex(path: Path) -> None:
    _write(path, np.concatenate([BALL.vertices, [[9.0, 9, 9]]]), BALL.faces)


DEFECTS: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "open": (_open, r"3 boundary edges \(open surface\)", "close the holes"),
    "non_manifold": (_non_manifold, r"more than two faces \(non-manifold\)", "split or remesh"),
    "pinched": (_pinched, r"joins several sheets \(non-manifold\)", "split the vertex"),
    "flipped": (_flipped, "disagree in orientation", "reorient the faces"),
    "inside_out": (_inside_out, "faces look inwards", "flip all faces"),
    "two_parts": (_two_parts, "2 connected components", "keep the largest or join them"),
    "genus_one": (_torus, r"Euler characteristic 0 \(genus 1\)", "cut the handles"),
    "nan": (_nan, "1 vertices are not finite numbers", "export it again"),
    "zero_area": (_zero_area, "triangles without area", "remesh it"),
    "flat": (_flat, "triangles without area", "remesh it"),
    "empty": (_empty_file, "is empty", "remove or replace it"),
    "no_triangles": (_no_triangles, "holds no triangles", "a triangle mesh is required"),
    "garbage": (_garbage, "cannot be read", "export it again"),
    "truncated": (_truncated, "cannot be read", "export it again"),
    "one_triangle": (_one_triangle, "1 faces", "replace it"),
    "stray_vertex": (_stray_vertex, "1 vertices belong to no face", "remove them"),
    "huge": (_too_many_faces, "327680 faces; at most 200000", "simplify it"),
}

BEYOND_REPAIR = {"empty", "no_triangles", "garbage", "truncated", "one_triangle"}


@pytest.mark.parametrize("defect", DEFECTS)
def test_defect_is_told_in_one_line(tmp_path: Path, defect: str) -> None:
    make, found, remedy = DEFECTS[defect]
    path = tmp_path / f"{defect}.ply"
    make(path)
    with pytest.raises(BadMesh, match=found) as raised:
        ShapeCollection.from_folder(tmp_path)
    head, line = str(raised.value).split("\n")
    assert "1 of 1 meshes cannot be used" in head
    assert "with on_bad=skip" in head
    assert line.startswith(f"{path}: ")
    assert any(word in line for word in ("required", "allowed", "at most", "at least"))
    assert remedy in line
    mended = f"gensp repair {path} {defect}_mended.ply"
    assert (mended in line) == (defect not in BEYOND_REPAIR)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    _write(tmp_path / "good.ply", BALL.vertices, BALL.faces)
    _write(tmp_path / "other.off", 2 * BALL.vertices, BALL.faces)
    _torus(tmp_path / "ring.ply")
    _open(tmp_path / "cup.obj")
    return tmp_path


def test_all_bad_files_are_listed_at_once(folder: Path) -> None:
    with pytest.raises(BadMesh) as raised:
        ShapeCollection.from_folder(folder)
    lines = str(raised.value).split("\n")
    assert "2 of 4 meshes" in lines[0]
    assert [line.split(":")[0] for line in lines[1:]] == [
        str(folder / "cup.obj"),
        str(folder / "ring.ply"),
    ]


def test_skipped_meshes_are_left_out_and_listed(folder: Path) -> None:
    shapes = ShapeCollection.from_folder(folder, on_bad="skip")
    assert shapes.ids() == ["good", "other"]
    assert [id for id, _ in shapes.skipped] == ["cup", "ring"]
    assert all("\n" not in reason for _, reason in shapes.skipped)
    assert "boundary edges" in shapes.skipped[0][1]


def test_a_folder_of_bad_meshes_is_no_collection(tmp_path: Path) -> None:
    _torus(tmp_path / "ring.ply")
    with pytest.raises(MissingData, match=r"none of 1 meshes can be used[^\0]*genus 1"):
        ShapeCollection.from_folder(tmp_path, on_bad="skip")


def test_unknown_rule_names_the_choices(folder: Path) -> None:
    with pytest.raises(Unsupported, match=r"^on_bad=ignore: .*error or skip"):
        ShapeCollection.from_folder(folder, on_bad="ignore")


def test_limit_of_faces_is_a_setting(folder: Path) -> None:
    shapes = ShapeCollection.from_folder(folder, on_bad="skip", max_faces=320)
    assert shapes.ids() == ["good", "other"]
    with pytest.raises(MissingData, match="at most 319"):
        ShapeCollection.from_folder(folder, on_bad="skip", max_faces=319)


def test_checked_files_are_remembered_by_content(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path_factory.mktemp("cache")
    first = ShapeCollection.from_folder(folder, on_bad="skip", cache=cache)
    read: list[str] = []

    def load(path: Path) -> Mesh:
        read.append(path.name)
        return Mesh(BALL.vertices, BALL.faces[1:])

    monkeypatch.setattr("gensp.geometry.mesh.load_mesh", load)
    again = ShapeCollection.from_folder(folder, on_bad="skip", cache=cache)
    assert again.ids() == first.ids()
    assert read == ["cup.obj", "ring.ply"]
    _write(folder / "good.ply", 3 * BALL.vertices, BALL.faces)
    changed = ShapeCollection.from_folder(folder, on_bad="skip", cache=cache)
    assert "good.ply" in read
    assert changed.ids() == ["other"]


def test_damaged_record_is_made_again(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cache = tmp_path_factory.mktemp("cache")
    ShapeCollection.from_folder(folder, on_bad="skip", cache=cache)
    (record,) = cache.iterdir()
    record.write_text("{")
    with pytest.warns(UserWarning, match="damaged; all meshes are checked again"):
        shapes = ShapeCollection.from_folder(folder, on_bad="skip", cache=cache)
    assert shapes.ids() == ["good", "other"]
