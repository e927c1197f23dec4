"""Where the commands write: a place that cannot be is told before anything is computed."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from gensp.cli.earlier import is_earlier
from gensp.cli.inputs import require_folder
from gensp.errors import OutputError
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.geometry.spherical_map import SphericalMap
from tests.cli.conftest import Refused, Run


@pytest.mark.parametrize("name", ["match", "morph"])
def test_a_file_is_no_folder_for_maps(refused: Refused, map_file: Path, name: str) -> None:
    line = refused(name, map_file, map_file, "--out", map_file)
    assert f"{map_file}: is a file; a folder is required" in line


def test_no_map_is_made_for_a_place_that_cannot_be(
    refused: Refused, bumpy_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The package has the command by the module's name.
    module = import_module("gensp.cli.parameterize")
    monkeypatch.setattr(module, "_write_map", lambda *_: pytest.fail("a map was made"))
    line = refused("parameterize", bumpy_file, "--out", bumpy_file / "below")
    assert f"{bumpy_file}: is a file; a folder is required" in line


@pytest.mark.parametrize(
    ("end", "more"),
    [
        (".ply", ()),
        (".npz", ()),
        ("_sphere.obj", ()),
        ("_textured.obj", ("--texture",)),
        ("_icosphere1.ply", ("--icosphere", 1)),
    ],
)
def test_another_file_of_the_name_of_a_result_is_kept(
    refused: Refused, bumpy_file: Path, bumpy: Mesh, end: str, more: tuple[str | int, ...]
) -> None:
    other = bumpy_file.parent / "maps" / f"bumpy{end}"
    other.parent.mkdir()
    if end == ".npz":
        np.savez(other, height=bumpy.vertices)
    else:
        save_mesh(bumpy, other)
    before = other.read_bytes()
    line = refused("parameterize", bumpy_file, "--out", other.parent, *more)
    assert f"{other}: is no result of gensp" in line
    assert line.endswith("add --out FOLDER")
    assert other.read_bytes() == before
    assert list(other.parent.iterdir()) == [other]


def test_results_are_replaced_by_those_of_the_same_command(gensp: Run, bumpy_file: Path) -> None:
    words = ("parameterize", bumpy_file, "--out", bumpy_file.parent / "maps", "--texture")
    for _ in range(2):
        assert gensp(*words, "--icosphere", 1)[0] == 0


def test_a_damaged_file_is_no_result(tmp_path: Path) -> None:
    for end in ("npz", "obj", "ply"):
        (tmp_path / f"cow.{end}").write_text("v 1 0 nothing")
        assert not is_earlier(tmp_path / f"cow.{end}")


def test_a_folder_is_no_file(refused: Refused, map_file: Path, bumpy_file: Path) -> None:
    folder = bumpy_file.parent / "mended.ply"
    folder.mkdir()
    told = f"{folder}: is a folder; a file is required; name one in it"
    assert told in refused("repair", bumpy_file, folder)
    assert told in refused("view", map_file, "--out", folder, "--no-open")
    assert told in refused(
        "transfer", map_file, map_file, "--attribute", f"{map_file}:sphere", "--out", folder
    )


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Whoever runs as root may write anywhere: the answer of the system is put in.
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    with pytest.raises(OutputError, match="permission is required"):
        require_folder(tmp_path / "new" / "deeper")


def test_values_that_are_no_numbers_are_counted(
    gensp: Run, bumpy_map: SphericalMap, map_file: Path, tmp_path: Path
) -> None:
    heights = bumpy_map.surface[:, 2].copy()
    heights[:3] = np.nan
    np.savez(tmp_path / "heights.npz", z=heights)
    words = ("--attribute", f"{tmp_path / 'heights.npz'}:z", "--out", tmp_path / "carried.npz")
    code, said, _ = gensp("transfer", map_file, map_file, *words)
    carried = np.load(tmp_path / "carried.npz")["z"]
    assert code == 0
    assert np.isnan(carried[:3]).all()
    assert f"3 of {len(heights)} vertices → {np.isnan(carried).sum()} of {len(heights)}" in said
