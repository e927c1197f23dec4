"""Meshes and maps for the commands, and running these in this process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gensp.cli import app
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap, save_map

Run = Callable[..., tuple[int, str, str]]
Refused = Callable[..., str]


@pytest.fixture
def gensp(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """`gensp(*words)` gives exit code, stdout and stderr."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["gensp", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            app()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return run


@pytest.fixture
def refused(gensp: Run) -> Refused:
    """`refused(*words)` expects exit code 2 and gives the one line on stderr."""

    def run(*words: object) -> str:
        code, _, said = gensp(*words)
        assert code == 2, said
        assert said.count("\n") == 1, said
        assert said.startswith("gensp")
        return said.strip()

    return run


@pytest.fixture
def bumpy_map(bumpy: Mesh) -> SphericalMap:
    """Radial projection: the bumpy sphere is star-shaped."""
    sphere = bumpy.vertices / np.linalg.norm(bumpy.vertices, axis=1, keepdims=True)
    return SphericalMap(sphere, bumpy.vertices, bumpy.faces, "bumpy")


@pytest.fixture
def bumpy_file(bumpy: Mesh, tmp_path: Path) -> Path:
    """The bumpy sphere as OBJ with all digits."""
    from gensp.export.wavefront import write_obj

    path = tmp_path / "bumpy.obj"
    write_obj(path, bumpy.vertices, bumpy.faces)
    return path


@pytest.fixture
def map_file(bumpy_map: SphericalMap, tmp_path: Path) -> Path:
    save_map(bumpy_map, tmp_path / "maps")
    return tmp_path / "maps" / "bumpy.npz"


@pytest.fixture
def other_file(dumbbell: Mesh, tmp_path: Path) -> Path:
    ball = dumbbell.vertices / np.linalg.norm(dumbbell.vertices, axis=1, keepdims=True)
    save_map(SphericalMap(ball, dumbbell.vertices, dumbbell.faces, "dumbbell"), tmp_path / "maps")
    return tmp_path / "maps" / "dumbbell.npz"
