"""Every command on good input, and on every kind of bad input."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import Run
from PIL import Image
from test_bad_meshes import DEFECTS

import gensp as package
from gensp.errors import BadMesh, Unsupported
from gensp.export.textured import write_textured
from gensp.geometry.certificate import certify
from gensp.geometry.mesh import Mesh, load_mesh, require_genus_zero, save_mesh
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map
from gensp.geometry.wavefront import read_obj
from gensp.pictures.texture import equirectangular_picture

BROKEN = [name for name in DEFECTS if name != "huge"]
Refused = Callable[..., str]


@pytest.fixture
def map_file(bumpy_map: SphericalMap, tmp_path: Path) -> Path:
    save_map(bumpy_map, tmp_path / "maps")
    return tmp_path / "maps" / "bumpy.npz"


@pytest.fixture
def other_file(dumbbell: Mesh, tmp_path: Path) -> Path:
    ball = dumbbell.vertices / np.linalg.norm(dumbbell.vertices, axis=1, keepdims=True)
    save_map(SphericalMap(ball, dumbbell.vertices, dumbbell.faces, "dumbbell"), tmp_path / "maps")
    return tmp_path / "maps" / "dumbbell.npz"


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


@pytest.mark.parametrize("end", [".glb", ".obj"])
def test_textured_files_wear_the_sphere(bumpy_map: SphericalMap, tmp_path: Path, end: str) -> None:
    picture = equirectangular_picture(64)
    write_textured(bumpy_map, picture, tmp_path / "bumpy")
    loaded = trimesh.load(tmp_path / f"bumpy{end}", process=False, force="mesh")
    uv, faces = np.array(loaded.visual.uv), np.array(loaded.faces)
    assert np.ptp(uv[faces, 0], axis=1).max() < 0.5
    longitude, latitude = 2 * np.pi * uv[:, 0], np.pi * (uv[:, 1] - 0.5)
    level = np.cos(latitude)
    p = np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], 1)
    x = np.array(loaded.vertices)
    # The map is the radial projection.
    np.testing.assert_allclose(x / np.linalg.norm(x, axis=1, keepdims=True), p, atol=1e-5)
    material = loaded.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    np.testing.assert_array_equal(np.asarray(image.convert("RGB")), picture)


def test_textured_obj_is_a_closed_surface(bumpy_map: SphericalMap, tmp_path: Path) -> None:
    write_textured(bumpy_map, equirectangular_picture(16), tmp_path / "bumpy")
    require_genus_zero(load_mesh(tmp_path / "bumpy.obj"))


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


def test_repair_refuses_formats_it_cannot_write(refused: Refused, tmp_path: Path) -> None:
    broken = tmp_path / "cup.ply"
    DEFECTS["open"][0](broken)
    assert "format '.xyz' is not written" in refused("repair", broken, tmp_path / "cup.xyz")


@pytest.mark.parametrize("defect", ["empty", "no_triangles", "garbage", "truncated", "flat"])
def test_repair_of_nothing_is_told(refused: Refused, tmp_path: Path, defect: str) -> None:
    path = tmp_path / f"{defect}.ply"
    DEFECTS[defect][0](path)
    for more in ((), ("--remesh",)):
        assert "required" in refused("repair", path, tmp_path / "mended.ply", *more)
    assert not (tmp_path / "mended.ply").exists()


def test_match_writes_both_ways(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    code, said, _ = gensp("match", map_file, other_file, "--out", tmp_path)
    assert code == 0
    assert "reliability" in said
    with np.load(tmp_path / "bumpy_to_dumbbell.npz") as found:
        there = {name: found[name] for name in found.files}
    target = load_map(other_file)
    corners = target.surface[target.faces[there["face"]]]
    positions = np.einsum("kj,kjc->kc", there["barycentric"], corners)
    np.testing.assert_allclose(positions, there["positions"])
    np.testing.assert_array_equal(there["rotation"], np.eye(3))
    assert 0 <= there["reliability"].min() <= there["reliability"].max() <= 1
    with open(tmp_path / "bumpy_to_dumbbell.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["face"]) for row in rows] == there["face"].tolist()
    assert [float(row["reliability"]) for row in rows] == there["reliability"].tolist()
    assert (tmp_path / "dumbbell_to_bumpy.npz").is_file()


def test_match_of_a_mesh_aligns(gensp: Run, bumpy_file: Path, map_file: Path) -> None:
    out = map_file.parent
    code, *_ = gensp("match", bumpy_file, map_file, "--out", out, "--align")
    assert code == 0
    with np.load(out / "bumpy1_to_bumpy2.npz") as found:
        error = np.linalg.norm(found["positions"] - load_map(map_file).surface, axis=1)
    assert np.median(error) < 0.1


def test_known_reliability_counts(gensp: Run, map_file: Path, tmp_path: Path) -> None:
    map = load_map(map_file)
    doubted = tmp_path / "doubted.npz"
    np.savez(
        doubted,
        vertices=map.surface,
        faces=map.faces,
        sphere=map.sphere,
        reliability=np.zeros(len(map.sphere)),
    )
    assert gensp("match", map_file, doubted, "--out", tmp_path)[0] == 0
    with np.load(tmp_path / "bumpy_to_doubted.npz") as found:
        assert not found["reliability"].any()


def test_transfer_of_numbers_and_colours(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    source, target = load_map(map_file), load_map(other_file)
    values = tmp_path / "values.npz"
    np.savez(values, height=source.sphere[:, 2])
    out = tmp_path / "height.npz"
    assert (
        gensp("transfer", map_file, other_file, "--attribute", f"{values}:height", "--out", out)[0]
        == 0
    )  # noqa: E501
    with np.load(out) as found:
        np.testing.assert_allclose(found["height"], target.sphere[:, 2], atol=0.01)
    painted, out = tmp_path / "painted.ply", tmp_path / "colours.ply"
    colours = np.rint(127 * (1 + source.sphere)).astype(np.uint8)
    trimesh.Trimesh(source.surface, source.faces, vertex_colors=colours, process=False).export(
        painted
    )
    assert gensp("transfer", map_file, other_file, "--attribute", painted, "--out", out)[0] == 0
    seen = trimesh.load(out, process=False)
    np.testing.assert_allclose(seen.visual.vertex_colors[:, :3], 127 * (1 + target.sphere), atol=3)
    np.testing.assert_array_equal(seen.vertices, target.surface)


def test_transfer_of_a_texture(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    # The source wears the sphere's texture, so the baked picture is that texture again.
    picture = equirectangular_picture(256)
    write_textured(load_map(map_file), picture, tmp_path / "dressed")
    code, *_ = gensp(
        "transfer", map_file, other_file, "--texture", tmp_path / "dressed.obj",
        "--height", 64, "--out", tmp_path / "carried",
    )  # fmt: skip
    assert code == 0
    baked = np.asarray(Image.open(tmp_path / "carried.png").convert("RGB")).astype(float)
    wanted = equirectangular_picture(64).astype(float)
    assert np.median(np.abs(baked - wanted)) < 4
    require_genus_zero(load_mesh(tmp_path / "carried.obj"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--attribute", "nowhere.npz:height"], "names no array"),
        (["--attribute", "{map}:height"], "has no array 'height'; it has"),
        (["--attribute", "{map}:faces"], "each of its 642 vertices is required"),
        (["--attribute", "{ply}"], "has no vertex colours"),
        (["--texture", "{ply}"], "no texture coordinates or no picture"),
        ([], "one of --attribute and --texture is required"),
    ],
)
def test_transfer_of_nothing_is_told(
    refused: Refused, map_file: Path, tmp_path: Path, words: list[str], told: str
) -> None:
    plain = tmp_path / "plain.ply"
    save_mesh(load_map(map_file).mesh, plain)
    typed = [word.format(map=map_file, ply=plain) for word in words]
    line = refused("transfer", map_file, map_file, *typed, "--out", tmp_path / "out.npz")
    assert told in line


def test_morph_writes_meshes_and_a_strip(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    words = ("--frames", 3, "--icosphere", 2, "--up", "z", "--out", tmp_path / "morph")
    assert gensp("morph", map_file, other_file, *words)[0] == 0
    frames = [load_mesh(tmp_path / "morph" / f"bumpy_dumbbell_00{k}.ply") for k in range(3)]
    middle = (frames[0].vertices + frames[2].vertices) / 2
    np.testing.assert_allclose(frames[1].vertices, middle, atol=1e-12)
    with Image.open(tmp_path / "morph" / "bumpy_dumbbell.png") as strip:
        assert strip.size == (900, 300)
        assert np.asarray(strip).std() > 20


def test_view_writes_a_page_without_network(gensp: Run, map_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert gensp("view", map_file, "--out", page, "--no-open")[0] == 0
    text = page.read_text()
    assert "bijective: 1280 faces" in text
    assert '"label": "sphere"' in text
    assert "http://" not in text
    assert "https://" not in text


def _maps(folder: Path, map: SphericalMap) -> dict[str, Path]:
    """Files that are no maps, each for its own reason."""
    arrays = {"vertices": map.surface, "faces": map.faces, "sphere": map.sphere}
    wrong = {
        "short": {"sphere": map.sphere[:-1]},
        "long": {"sphere": 2 * map.sphere},
        "nan": {"sphere": map.sphere * np.nan},
        "far": {"faces": map.faces + 1000},
        "real": {"faces": map.faces * 1.0},
    }
    for name, change in wrong.items():
        np.savez(folder / f"{name}.npz", **{**arrays, **change})
    np.savez(folder / "lacking.npz", vertices=map.surface, faces=map.faces)
    np.savez(folder / "folded.npz", **{**arrays, "sphere": _folded(map)})
    (folder / "garbage.npz").write_bytes(b"no zip at all")
    (folder / "empty.npz").write_bytes(b"")
    names = [*wrong, "lacking", "folded", "garbage", "empty", "missing"]
    return {name: folder / f"{name}.npz" for name in names}


def _folded(map: SphericalMap) -> np.ndarray:
    sphere = map.sphere.copy()
    sphere[0] = -sphere[0]
    return sphere


@pytest.mark.parametrize("command", ["match", "transfer", "morph", "view"])
def test_bad_maps_are_told_in_one_line(
    refused: Refused, bumpy_map: SphericalMap, map_file: Path, tmp_path: Path, command: str
) -> None:
    for name, path in _maps(tmp_path, bumpy_map).items():
        if (command, name) == ("view", "folded"):
            continue  # a page may show what is wrong
        words = (path,) if command == "view" else (map_file, path)
        more = ("--attribute", f"{map_file}:sphere") if command == "transfer" else ()
        line = refused(command, *words, *more, "--out", tmp_path / "out.npz")
        assert str(path) in line
        assert "required" in line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["parameterize", "{mesh}", "--method", "magic"], "one of dirichlet, cmcf is required"),
        (["parameterize", "{mesh}", "--checkpoint", "no.pt"], "no.pt: does not exist"),
        (["parameterize", "{mesh}", "--register"], "--checkpoint is required"),
        (["parameterize", "{mesh}", "--checkpoint", "a.pt", "--method", "cmcf"], "leave one out"),
        (["parameterize", "{mesh}", "--geometry-image", "1"], "parameterize --help"),
        (["parameterize", "{mesh}", "--colour"], "parameterize --help"),
        (["morph", "{mesh}", "{mesh}", "--up", "w"], "one of x, y, z"),
        (["paint"], "No such command 'paint'; see gensp --help"),
    ],
)
def test_wrong_words_are_told_in_one_line(
    refused: Refused, bumpy_file: Path, words: list[str], told: str
) -> None:
    assert told in refused(*[word.format(mesh=bumpy_file) for word in words])


def test_folder_that_cannot_be_written(refused: Refused, bumpy_file: Path) -> None:
    line = refused("parameterize", bumpy_file, "--out", bumpy_file / "below")
    assert "cannot be written" in line
    assert "paths.runs" not in line


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
    done = subprocess.run(
        [sys.executable, "-m", "gensp", "--help"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0
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
