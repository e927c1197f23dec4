"""`gensp parameterize`: every file it writes reads back."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from conftest import Refused, Run
from PIL import Image

import gensp as package
from gensp.cli.parameterize import _rung
from gensp.errors import BadMesh, NotEmbeddable, Unsupported
from gensp.export.textured import write_textured
from gensp.geometry.certificate import certify, place_of
from gensp.geometry.mesh import Mesh, load_mesh, require_genus_zero, save_mesh
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.geometry.wavefront import read_obj
from gensp.methods.refinement import RUNGS
from gensp.methods.table import PER_SHAPE
from gensp.pictures.texture import equirectangular_picture


def test_parameterize_writes_what_reads_back_certified(
    gensp: Run, bumpy_file: Path, tmp_path: Path, bumpy: Mesh
) -> None:
    out = tmp_path / "out"
    code, said, _ = gensp(
        "parameterize", bumpy_file, "--out", out, "--texture", "--icosphere", 2,
        "--geometry-image", 16,
    )  # fmt: skip
    assert code == 0
    assert "bijective: 1280 faces" in said
    assert all(path.name in said for path in out.iterdir())
    map = load_map(out / "bumpy.npz")
    np.testing.assert_array_equal(map.surface, bumpy.vertices)
    np.testing.assert_array_equal(map.faces, bumpy.faces)
    assert certify(map.sphere, map.faces)
    sphere, faces = read_obj(out / "bumpy_sphere.obj")
    np.testing.assert_array_equal(sphere, map.sphere)
    np.testing.assert_array_equal(faces, map.faces)
    _same_in_ply(out / "bumpy.ply", map)
    remesh = load_map(out / "bumpy_icosphere2.npz")
    np.testing.assert_allclose(remesh.surface, map.icosphere_remesh(2).vertices)
    with Image.open(out / "bumpy_geometry16.png") as picture:
        assert picture.size == (16, 16)


def _same_in_ply(path: Path, map: SphericalMap) -> None:
    vertex = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
    sphere = np.stack([vertex[name].reshape(-1) for name in ("px", "py", "pz")], axis=1)
    np.testing.assert_array_equal(sphere, map.sphere)
    np.testing.assert_array_equal(load_mesh(path).vertices, map.surface)
    assert certify(sphere, load_mesh(path).faces)


def test_glb_reads_its_picture_at_full_size(map_file: Path, tmp_path: Path) -> None:
    """Without mipmaps, which blur it at the poles; repeated along the longitude."""
    map, picture = load_map(map_file), np.zeros((8, 16, 3), dtype=np.uint8)
    (glb, *_) = write_textured(map, picture, tmp_path / "shape")
    content = glb.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    tree = json.loads(content[20 : 20 + length])
    (texture,), (sampler,) = tree["textures"], tree["samplers"]
    assert texture["sampler"] == 0
    linear, repeat = 9729, 10497
    assert (sampler["magFilter"], sampler["minFilter"]) == (linear, linear)
    assert sampler["wrapS"] == repeat


@pytest.mark.parametrize("end", [".glb", ".obj"])
def test_textured_files_wear_the_sphere(bumpy_map: SphericalMap, tmp_path: Path, end: str) -> None:
    picture = equirectangular_picture(64)
    larger = SphericalMap(bumpy_map.sphere, 2 * bumpy_map.sphere, bumpy_map.faces)
    write_textured(larger, picture, tmp_path / "bumpy")
    loaded = trimesh.load(tmp_path / f"bumpy{end}", process=False, force="mesh")
    uv, faces = np.array(loaded.visual.uv), np.array(loaded.faces)
    assert np.ptp(uv[faces, 0], axis=1).max() < 0.5
    longitude, latitude = 2 * np.pi * uv[:, 0], np.pi * (uv[:, 1] - 0.5)
    level = np.cos(latitude)
    p = np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], 1)
    x = np.array(loaded.vertices)
    np.testing.assert_allclose(x / np.linalg.norm(x, axis=1, keepdims=True), p, atol=1e-5)
    material = loaded.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    np.testing.assert_array_equal(np.asarray(image.convert("RGB")), picture)


def test_textured_obj_is_a_closed_surface(bumpy_map: SphericalMap, tmp_path: Path) -> None:
    write_textured(bumpy_map, equirectangular_picture(16), tmp_path / "bumpy")
    require_genus_zero(load_mesh(tmp_path / "bumpy.obj"))


def test_folder_that_cannot_be_written(refused: Refused, bumpy_file: Path) -> None:
    line = refused("parameterize", bumpy_file, "--out", bumpy_file / "below")
    assert "is a file; a folder is required" in line
    assert "paths.runs" not in line


def test_what_is_no_mesh_is_told_by_what_it_is(refused: Refused, tmp_path: Path) -> None:
    assert "is a folder; one mesh is required" in refused("parameterize", tmp_path)
    line = refused("parameterize", tmp_path / "none.obj")
    assert "does not exist; a triangle mesh is required; correct the path" in line


def test_version(gensp: Run) -> None:
    assert gensp("--version") == (0, f"gensp {package.__version__}\n", "")


def test_help_names_every_method(gensp: Run) -> None:
    said = gensp("parameterize", "--help")[1]
    assert not [name for name in PER_SHAPE if name not in said]


def test_a_mesh_is_not_overwritten_by_its_map(
    refused: Refused, bumpy: Mesh, tmp_path: Path
) -> None:
    path = tmp_path / "cow.ply"
    save_mesh(bumpy, path)
    before = path.read_bytes()
    said = refused("parameterize", path, "--out", tmp_path)
    assert "would be overwritten by its map" in said
    assert "--out FOLDER" in said
    assert path.read_bytes() == before


@pytest.fixture
def limbed_file(limbed: Mesh, tmp_path: Path) -> Path:
    """A shape on which the raw flow folds."""
    from gensp.export.wavefront import write_obj

    path = tmp_path / "limbed.obj"
    write_obj(path, limbed.vertices, limbed.faces)
    return path


def test_a_folded_map_is_written_and_told(gensp: Run, limbed_file: Path, tmp_path: Path) -> None:
    words = ("--method", "cmcf_raw", "--out", tmp_path / "out", "--texture", "--icosphere", 2)
    code, said, line = gensp("parameterize", limbed_file, *words)
    assert code == 2
    map, mesh = load_map(tmp_path / "out" / "limbed.npz"), load_mesh(limbed_file)
    faults = map.certify().faults
    assert f"not bijective: {len(faults)} of {len(map.faces)} faces" in said
    assert line == (
        f"gensp: limbed: {len(faults)} of {len(map.faces)} faces are folded or without area on "
        f"the sphere (first: {place_of(mesh, int(faults[0]))}); a bijective map of degree 1 is "
        "required; use --method dirichlet\n"
    )
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == ["limbed.npz", "limbed.ply", "limbed_sphere.obj"]


def test_the_ladder_ends_in_a_bijective_map_of_the_flow(
    gensp: Run, limbed_file: Path, tmp_path: Path
) -> None:
    code, said, _ = gensp("parameterize", limbed_file, "--method", "cmcf", "--out", tmp_path)
    assert code == 0
    rung = load_map(tmp_path / "limbed.npz").diagnostics["rung"]
    assert f"{rung}: {RUNGS[rung]}" in said


def test_a_folded_array_is_refused_and_its_map_handed_out(limbed: Mesh) -> None:
    with pytest.raises(NotEmbeddable, match=r"first: face .*; use method='dirichlet', or look"):
        package.parameterize(limbed.vertices, limbed.faces, method="cmcf_raw")
    map = package.spherical_map(limbed.vertices, limbed.faces, method="cmcf_raw")
    assert len(map.certify().faults) > 0


@pytest.mark.parametrize("name", ["arap", "vc25"])
def test_methods_that_may_fold_can_be_named(
    gensp: Run, bumpy_file: Path, tmp_path: Path, name: str
) -> None:
    """This shape they do not fold."""
    code, said, _ = gensp("parameterize", bumpy_file, "--method", name, "--out", tmp_path)
    assert code == 0
    assert "bijective: 1280 faces" in said


def test_a_method_that_needs_a_model_says_so(refused: Refused, bumpy_file: Path) -> None:
    line = refused("parameterize", bumpy_file, "--method", "gensp")
    assert "a trained model is required; name it with --model" in line


def test_arrays(bumpy: Mesh) -> None:
    sphere = package.parameterize(bumpy.vertices.tolist(), bumpy.faces.astype(np.int32))
    assert certify(sphere, bumpy.faces)
    map = package.spherical_map(bumpy.vertices, bumpy.faces, method="cmcf", name="mine")
    assert map.name == "mine"
    own = package.parameterize(bumpy.vertices, bumpy.faces, method=lambda mesh: map)
    np.testing.assert_array_equal(own, map.sphere)


def test_arrays_that_are_no_mesh(bumpy: Mesh) -> None:
    with pytest.raises(BadMesh, match=r"\(n, 3\) numbers and \(m, 3\) integers are required"):
        package.parameterize(bumpy.vertices[:, :2], bumpy.faces)
    with pytest.raises(BadMesh, match="integers are required"):
        package.parameterize(bumpy.vertices, bumpy.faces * 1.0)
    with pytest.raises(BadMesh, match="boundary edges"):
        package.parameterize(bumpy.vertices, bumpy.faces[1:])
    with pytest.raises(Unsupported, match="method 'magic': is not known"):
        package.parameterize(bumpy.vertices, bumpy.faces, method="magic")


def test_console_script_runs_and_stays_light() -> None:
    for words in ([], ["--help"]):
        done = subprocess.run(
            [sys.executable, "-m", "gensp", *words], capture_output=True, text=True, timeout=60
        )
        assert (done.returncode, done.stderr) == (0, "")
    for command in ("parameterize", "check", "repair", "match", "transfer", "morph", "view"):
        assert command in done.stdout
    heavy = ["numpy", "scipy", "igl", "trimesh", "torch", "matplotlib", "lightning", "hydra"]
    script = f"import sys, gensp.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_a_map_needs_no_training_libraries(bumpy_file: Path, tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "for name in ('torch', 'lightning', 'hydra', 'matplotlib', 'wandb'):\n"
        "    sys.modules[name] = None\n"
        "from gensp.cli import app\n"
        f"sys.argv = ['gensp', 'parameterize', {str(bumpy_file)!r}, '--out', {str(tmp_path)!r},\n"
        "            '--texture', '--icosphere', '2', '--geometry-image', '8']\n"
        "app()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "bumpy_textured.glb").is_file()


def test_model_from_a_file(gensp: Run, bumpy: Mesh, bumpy_file: Path, tmp_path: Path) -> None:
    from test_methods_gensp import networks

    from gensp.models import save_model

    trained = networks()
    with torch.no_grad():
        trained["encoder"].set_origin(torch.randn(2, 96, 3))
    save_model(tmp_path / "model.pt", **trained)
    words = ("--checkpoint", tmp_path / "model.pt", "--out", tmp_path / "out")
    code, said, _ = gensp("parameterize", bumpy_file, *words)
    assert code == 0
    assert "bijective: 1280 faces" in said
    model = package.load(tmp_path / "model.pt")
    own = package.parameterize(bumpy.vertices, bumpy.faces, method=model)
    np.testing.assert_array_equal(own, load_map(tmp_path / "out" / "bumpy.npz").sphere)


def test_slow_maps_say_how_far_they_are(
    gensp: Run, bumpy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gensp.cli.terminal.EVERY", 0.0)
    code, _, said = gensp("parameterize", bumpy_file, "--out", tmp_path)
    lines = said.splitlines()
    assert code == 0
    assert "bumpy: growing the map: 642 of 642 vertices" in lines
    assert all(line.startswith("bumpy: ") for line in lines)


@pytest.mark.parametrize(
    ("shape", "meaning"),
    [
        ("heads/meshes/id012_neutral", "like those that the model knows: gap"),
        ("quadrupeds/meshes/husky_rest", "far from what the model knows: gap"),
    ],
)
def test_a_model_tells_what_is_far_from_what_it_knows(
    gensp: Run, tmp_path: Path, shape: str, meaning: str
) -> None:
    mesh = Path(__file__).parents[2] / "data" / f"{shape}.ply"
    code, said, _ = gensp("parameterize", mesh, "--model", "heads", "--out", tmp_path)
    assert code == 0
    assert meaning in said


@pytest.mark.parametrize(
    ("method", "told"),
    [("stretch", "try --method dirichlet"), ("dirichlet", "triangles are too thin")],
)
def test_what_stopped_early_is_told_what_helps(
    bumpy_map: SphericalMap, method: str, told: str
) -> None:
    stopped = replace(bumpy_map, diagnostics={"rung": "hierarchical", "converged": False})
    (_, said) = dict(_rung(stopped, method)).popitem()
    assert said.startswith("stopped before it converged")
    assert told in said
