"""The scripts in examples/ run as their first lines say."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gensp.geometry.mesh import Mesh, load_mesh, save_mesh
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map
from gensp.models import AnchoredGenerator, PointNet2Encoder, save_model

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def model(tmp_path) -> Path:
    """Untrained networks of the product's kind."""
    torch.manual_seed(0)
    encoder = PointNet2Encoder(6, width=8, groups=((32, 8), (8, 4)))
    with torch.no_grad():
        encoder.set_origin(torch.randn(2, 96, 3))
    generator = AnchoredGenerator(6, rank=2, width=16, depth=2)
    torch.nn.init.normal_(generator.trunk.last.weight, std=0.05)
    save_model(tmp_path / "model.pt", encoder=encoder, generator=generator)
    return tmp_path / "model.pt"


def run_example(monkeypatch, name: str, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.mark.parametrize("learnt", [False, True])
def test_parameterize_one_mesh(tmp_path, monkeypatch, capsys, bumpy: Mesh, model, learnt):
    save_mesh(bumpy, tmp_path / "bumpy.ply")
    chosen = ["--model", model] if learnt else []
    words = (tmp_path / "bumpy.ply", *chosen, "--out", tmp_path / "out")
    run_example(monkeypatch, "parameterize_one_mesh.py", *words)
    map = load_map(tmp_path / "out" / "bumpy.npz")
    np.testing.assert_array_equal(map.faces, bumpy.faces)
    assert not map.bad_faces().any()
    assert (tmp_path / "out" / "bumpy.png").stat().st_size > 1000
    assert "0 bad faces" in capsys.readouterr().out


def test_morph_two_shapes(tmp_path, monkeypatch, bumpy: Mesh, ellipsoid: Mesh, model):
    for mesh in (bumpy, ellipsoid):
        save_mesh(mesh, tmp_path / f"{mesh.name}.ply")
    words = (model, tmp_path / "bumpy.ply", tmp_path / "ellipsoid.ply")
    sizes = ("--frames", 3, "--level", 2, "--out", tmp_path / "out")
    run_example(monkeypatch, "morph_two_shapes.py", *words, *sizes)
    frames = sorted((tmp_path / "out" / "bumpy-ellipsoid").glob("*.ply"))
    first, middle, last = (load_mesh(path).vertices for path in frames)
    assert np.abs(first - last).max() > 0
    np.testing.assert_allclose(middle, (first + last) / 2, atol=0.1)
    assert (tmp_path / "out" / "bumpy-ellipsoid.png").exists()


def test_bad_input_is_told_in_one_line(tmp_path, monkeypatch, bumpy: Mesh, model):
    """Meshes with a hole, and an npz that is no map."""
    paths = [tmp_path / f"{name}.ply" for name in ("cup", "bowl")]
    for path in paths:
        save_mesh(Mesh(bumpy.vertices, bumpy.faces[1:]), path)
    np.savez(tmp_path / "heights.npz", height=bumpy.vertices)
    for name, words, told in (
        ("parameterize_one_mesh.py", paths[:1], "cup: 3 boundary edges"),
        ("morph_two_shapes.py", [model, *paths], "cup: 3 boundary edges"),
        ("shape_model.py", [tmp_path], f"{tmp_path / 'heights.npz'}: arrays faces, sphere"),
    ):
        with pytest.raises(SystemExit) as ended:
            run_example(monkeypatch, name, *words, "--out", tmp_path / "out")
        assert str(ended.value).startswith(told)
        assert "\n" not in str(ended.value)


# What Register does with its output, as its README tells: the source, its sphere turned.
REGISTER = """
from pathlib import Path
from gensp.geometry.ply import ply_bytes
from gensp.geometry.mesh import load_mesh
from gensp.geometry.sphere_files import read_sphere_positions
import numpy as np
assert sys.argv[1] == "--in" and sys.argv[4] == "--out" and Path(sys.argv[3]).is_file()
mesh = load_mesh(sys.argv[2])
sphere = read_sphere_positions(Path(sys.argv[2]), len(mesh.vertices))
rows = np.hstack([mesh.vertices, sphere[:, [1, 2, 0]]])
names = ("x", "y", "z", "px", "py", "pz")
Path(sys.argv[5]).write_bytes(ply_bytes(names, rows, mesh.faces))
"""


def test_register_by_program(tmp_path, monkeypatch, capsys, bumpy: Mesh):
    sphere = unit(bumpy.vertices)
    for name, positions in (("a", sphere), ("b", sphere[:, [1, 2, 0]])):
        save_map(SphericalMap(positions, bumpy.vertices, bumpy.faces, name), tmp_path)
    program = tmp_path / "Register"
    root = str(EXAMPLES.parent)
    program.write_text(f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {root!r})\n{REGISTER}")
    program.chmod(0o755)
    words = (tmp_path / "a.ply", tmp_path / "b.ply", "--program", program)
    run_example(monkeypatch, "register_by_program.py", *words)
    assert "apart by 0.000 degrees" in capsys.readouterr().out


def test_shape_model_finds_the_one_way_in_which_shapes_differ(tmp_path, monkeypatch, bumpy: Mesh):
    """Stretched copies, turned and moved: one mode has all the variance."""
    turn = Rotation.random(5, rng=np.random.default_rng(0))
    maps = tmp_path / "maps"
    for k, stretch in enumerate((0.8, 0.9, 1.0, 1.1, 1.2)):
        shape = turn[k].apply(bumpy.vertices * [stretch, 1, 1]) + k
        save_map(SphericalMap(unit(bumpy.vertices), shape, bumpy.faces, f"shape{k}"), maps)
    out = tmp_path / "out"
    run_example(monkeypatch, "shape_model.py", maps, "--level", 3, "--modes", 1, "--out", out)
    with np.load(out / "shape_model.npz") as model:
        variance, modes, mean = model["deviations"] ** 2, model["modes"], model["mean"]
        assert list(model["names"]) == [f"shape{k}" for k in range(5)]
    assert variance[0] > 0.99 * variance.sum()
    np.testing.assert_allclose(np.linalg.norm(modes[0]), 1)
    plus, minus = (load_mesh(out / f"mode1_{word}.ply").vertices for word in ("plus", "minus"))
    np.testing.assert_allclose((plus + minus) / 2, mean, atol=1e-6)
    assert (out / "shape_model.png").stat().st_size > 1000
