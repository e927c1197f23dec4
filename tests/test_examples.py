"""The scripts in examples/ run as their first lines say."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from gensp.geometry.mesh import Mesh, load_mesh, save_mesh
from gensp.geometry.spherical_map import load_map
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
