"""Where the commands write: a place that cannot be is told before anything is computed."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from gensp.cli.inputs import require_folder
from gensp.errors import OutputError
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
