"""`gensp check` and `gensp repair` on good and bad files."""

import re
import shlex
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import Refused, Run
from test_bad_meshes import DEFECTS

from gensp.geometry.diagnosis import diagnose
from gensp.geometry.mesh import Mesh, load_mesh, require_genus_zero, save_mesh
from gensp.geometry.sphere import icosphere

BROKEN = [name for name in DEFECTS if name != "huge"]


@pytest.mark.parametrize("defect", BROKEN)
@pytest.mark.parametrize("command", ["parameterize", "check", "match"])
def test_bad_meshes_are_told_in_one_line(
    refused: Refused, tmp_path: Path, defect: str, command: str
) -> None:
    path = tmp_path / f"{defect}.ply"
    DEFECTS[defect][0](path)
    words = {"match": (path, path)}.get(command, (path,))
    line = refused(command, *words, *(("--out", tmp_path) if command != "check" else ()))
    assert str(path) in line
    assert "required" in line
    assert "shapes.on_bad" not in line
    assert sorted(tmp_path.iterdir()) == [path]


def test_remedy_is_a_command_that_mends(
    gensp: Run, refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    DEFECTS["open"][0](tmp_path / "my cup.ply")
    line = refused("parameterize", "my cup.ply")
    words = shlex.split(line.split("type: ")[1])
    assert words == ["gensp", "repair", "my cup.ply", "my cup_mended.ply"]
    assert gensp(*words[1:])[0] == 0
    require_genus_zero(load_mesh("my cup_mended.ply"))
    DEFECTS["genus_one"][0](tmp_path / "ring.ply")
    assert refused("parameterize", "ring.ply").endswith("ring_mended.ply --remesh")


def test_check_lists_all_and_ends_well_if_all_are_usable(
    gensp: Run, bumpy_file: Path, tmp_path: Path
) -> None:
    code, said, complaint = gensp("check", bumpy_file, bumpy_file)
    assert (code, complaint) == (0, "")
    assert said.count("usable") == 2
    ring = tmp_path / "ring.ply"
    DEFECTS["genus_one"][0](ring)
    code, said, _ = gensp("check", bumpy_file, ring, tmp_path / "missing.ply")
    assert code == 2
    for words in ("nothing", "genus 1", "gensp repair --remesh", "does not exist"):
        assert words in said


def test_a_mesh_beyond_the_limit_is_told_how_to_be_made_smaller(
    gensp: Run, refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bumpy: Mesh
) -> None:
    monkeypatch.chdir(tmp_path)
    save_mesh(bumpy, tmp_path / "bumpy.ply")
    remedy = "gensp repair bumpy.ply bumpy_mended.ply --remesh --vertices 100"
    told = "1280 faces (at most 1000 are taken)"
    said = gensp("check", "bumpy.ply", "--max-faces", 1000)[1]
    assert told in said
    assert f"type: {remedy}\n" in said
    limited = partial(diagnose, max_faces=1000)
    monkeypatch.setattr("gensp.cli.inputs.diagnose", limited)
    line = f"gensp: bumpy.ply: {told}; fewer faces are required; type: {remedy}"
    assert refused("parameterize", "bumpy.ply") == line
    assert gensp(*remedy.split()[1:])[0] == 0
    assert gensp("check", "bumpy_mended.ply", "--max-faces", 1000)[0] == 0


def test_check_breaks_no_name(gensp: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "a_folder_whose_name_alone_fills_half_of_a_line"
    folder.mkdir()
    ring = folder / "a_mesh_with_a_name_as_long_as_that_of_its_folder.ply"
    DEFECTS["genus_one"][0](ring)
    monkeypatch.setenv("COLUMNS", "80")
    lines = gensp("check", ring)[1].splitlines()
    assert lines[0] == str(ring)
    assert lines[-2] == "  genus 1 → gensp repair --remesh"
    assert lines[-1] == f"  type: gensp repair {ring} {ring.stem}_mended.ply --remesh"


def test_repair_tells_the_area_that_it_drops(gensp: Run, tmp_path: Path) -> None:
    """A ball with half the radius of the other has a fifth of the area of both."""
    ball, two = icosphere(2), tmp_path / "two.ply"
    both = np.concatenate([ball.vertices, ball.vertices / 2 + 3])
    save_mesh(Mesh(both, np.concatenate([ball.faces, ball.faces + len(ball.vertices)])), two)
    code, said, _ = gensp("repair", two, tmp_path / "one.ply")
    assert code == 0
    assert re.search(r"area of the dropped parts *│ 20\.0% of all parts'", said)
    assert len(load_mesh(tmp_path / "one.ply").faces) == len(ball.faces)


@pytest.mark.parametrize("end", [".ply", ".obj", ".off"])
def test_repair_writes_a_sound_mesh(gensp: Run, tmp_path: Path, end: str) -> None:
    broken, mended = tmp_path / "cup.ply", tmp_path / f"mended{end}"
    DEFECTS["open"][0](broken)
    code, said, _ = gensp("repair", broken, mended)
    assert code == 0
    assert "holes filled" in said
    assert "0 of the diagonal" in said
    require_genus_zero(load_mesh(mended))


def test_repair_remeshes_when_asked(gensp: Run, refused: Refused, tmp_path: Path) -> None:
    parts, mended = tmp_path / "ring.ply", tmp_path / "mended.ply"
    DEFECTS["genus_one"][0](parts)
    line = refused("repair", parts, mended)
    assert "genus 1 left after mending" in line
    assert "--remesh" in line
    assert not mended.exists()
    code, said, _ = gensp(
        "repair", parts, mended, "--remesh", "--resolution", 24, "--vertices", 600
    )
    assert code == 0
    assert "1 → 0" in said
    require_genus_zero(load_mesh(mended))


def test_remeshing_says_how_far_it_is(
    gensp: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ring, words = tmp_path / "ring.ply", ("--remesh", "--resolution", 24, "--vertices", 600)
    DEFECTS["genus_one"][0](ring)
    monkeypatch.setattr("gensp.cli.terminal.EVERY", 0.0)
    code, _, said = gensp("repair", ring, tmp_path / "mended.ply", *words)
    lines = said.splitlines()
    assert code == 0
    surface = "ring: surface on a grid of 24 cells"
    assert lines[:2] == ["ring: flood of a grid of 24 cells", surface]
    assert len(lines) > 2, "the handle is closed by balls, one after the other"
    assert all(line.startswith(f"{surface}, ") for line in lines[2:])


def test_repair_refuses_formats_it_cannot_write(refused: Refused, tmp_path: Path) -> None:
    broken = tmp_path / "cup.ply"
    DEFECTS["open"][0](broken)
    assert "format '.xyz' is not written" in refused("repair", broken, tmp_path / "cup.xyz")


def test_a_mesh_is_not_overwritten_by_what_is_mended(refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "two.ply"
    DEFECTS["two_parts"][0](path)
    before = path.read_bytes()
    assert "would be overwritten by what is mended" in refused("repair", path, path)
    assert path.read_bytes() == before
    assert f"{tmp_path}: is a folder; one of .ply" in refused("repair", path, tmp_path)


@pytest.mark.parametrize("defect", ["empty", "no_triangles", "garbage", "truncated", "flat"])
def test_repair_of_nothing_is_told(refused: Refused, tmp_path: Path, defect: str) -> None:
    path = tmp_path / f"{defect}.ply"
    DEFECTS[defect][0](path)
    for more in ((), ("--remesh",)):
        assert "required" in refused("repair", path, tmp_path / "mended.ply", *more)
    assert not (tmp_path / "mended.ply").exists()


def test_a_hole_that_is_left_names_the_option_that_closes_it(
    gensp: Run, refused: Refused, tmp_path: Path
) -> None:
    path = tmp_path / "open.ply"
    DEFECTS["open"][0](path)
    line = refused("repair", path, tmp_path / "mended.ply", "--largest-hole", 0.001)
    words = shlex.split(line.split("type: ")[1])
    assert words[:4] == ["gensp", "repair", str(path), str(tmp_path / "mended.ply")]
    assert words[4] == "--largest-hole"
    assert gensp(*words[1:])[0] == 0


@pytest.mark.parametrize("soup", [False, True])
def test_a_long_rim_is_measured(
    gensp: Run,
    refused: Refused,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    soup: bool,
) -> None:
    """More than half of a ball: its rim is 6, the diagonal 3.1; a soup shares no corner."""
    monkeypatch.chdir(tmp_path)
    ball = icosphere(3)
    low = ball.faces[(ball.vertices[ball.faces][:, :, 2] < 0.3).all(axis=1)]
    bowl = Mesh(ball.vertices[low].reshape(-1, 3), np.arange(low.size).reshape(-1, 3))
    save_mesh(bowl if soup else Mesh(ball.vertices, low), tmp_path / "bowl.ply")
    remedy = "gensp repair bowl.ply bowl_mended.ply --largest-hole 2"
    assert f"type: {remedy}" in gensp("check", "bowl.ply")[1]
    line = refused("parameterize", "bowl.ply")
    words = shlex.split(line.split("type: ")[1])
    assert gensp(*words[1:])[0] == 0
    require_genus_zero(load_mesh("bowl_mended.ply"))
