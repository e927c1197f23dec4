"""`gensp match`, `transfer`, `morph` and `view` on good maps and on files that are none."""

import csv
import re
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import Refused, Run
from PIL import Image

from gensp.export.textured import write_textured
from gensp.geometry.mesh import load_mesh, require_genus_zero, save_mesh
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map
from gensp.pictures.texture import equirectangular_picture


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


def test_match_tells_how_reliable_it_is(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    said = gensp("match", map_file, other_file, "--out", tmp_path)[1]
    for first, second in permutations(("bumpy", "dumbbell")):
        with np.load(tmp_path / f"{first}_to_{second}.npz") as found:
            values = found["reliability"]
        tenth = np.quantile(values, 0.1)
        assert np.mean(values < tenth) == pytest.approx(0.1, abs=0.01)
        told = f"mean {values.mean():.2f}, a tenth below {tenth:.2f}"
        assert re.search(rf"{first} → {second}: reliability *│ {told} *│", said)


def test_match_of_a_mesh_aligns(gensp: Run, bumpy_file: Path, map_file: Path) -> None:
    out = map_file.parent
    code, *_ = gensp("match", bumpy_file, map_file, "--out", out, "--align")
    assert code == 0
    with np.load(out / "bumpy1_to_bumpy2.npz") as found:
        error = np.linalg.norm(found["positions"] - load_map(map_file).surface, axis=1)
    assert np.median(error) < 0.1


@pytest.mark.parametrize("command", ["match", "morph"])
def test_the_ply_of_a_map_is_not_mapped_anew(
    refused: Refused, map_file: Path, other_file: Path, tmp_path: Path, command: str
) -> None:
    said = refused(command, map_file.with_suffix(".ply"), other_file, "--out", tmp_path)
    assert f"is the PLY of a map; the npz beside it is required; name {map_file}" in said


def test_a_mirrored_map_has_no_counterpart(
    refused: Refused, bumpy_map: SphericalMap, other_file: Path, tmp_path: Path
) -> None:
    mirrored = replace(bumpy_map, sphere=bumpy_map.sphere * [1, 1, -1], name="mirrored")
    save_map(mirrored, tmp_path)
    said = refused("match", other_file, tmp_path / "mirrored.npz", "--out", tmp_path)
    assert "mirrored.npz: mirrors its surface, and the other map does not" in said


def test_maps_that_may_not_share_a_sphere_are_told(
    gensp: Run, map_file: Path, other_file: Path, tmp_path: Path
) -> None:
    """The first is one of a model: its reliability is known."""
    with np.load(map_file) as found:
        arrays = {name: found[name] for name in found.files}
    np.savez(map_file, **arrays, reliability=np.ones(len(arrays["sphere"])))
    few = ("--frames", 2, "--icosphere", 2)
    carry = ("--attribute", f"{map_file}:sphere", "--out", tmp_path / "out.npz")
    for command, *more in (("match",), ("morph", *few), ("transfer", *carry)):
        out = () if "--out" in more else ("--out", tmp_path)
        code, _, said = gensp(command, map_file, other_file, *more, *out)
        assert code == 0
        assert said.startswith(f"gensp: {other_file}: no array 'reliability'")
        assert "--align" in said
        assert said.count("\n") == 1
    for option in ("--align", "--no-align"):
        assert gensp("match", map_file, other_file, option, "--out", tmp_path)[2] == ""
    assert gensp("match", map_file, map_file, "--out", tmp_path)[2] == ""


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
    )
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
        (["--attribute", "{map}:sphere", "--texture", "{ply}"], "together; one of them"),
        ([], "nothing to carry; --attribute FILE.npz:NAME or --texture FILE is required"),
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


def test_view_of_a_mesh_says_how_to_get_its_map(refused: Refused, bumpy_file: Path) -> None:
    folder = bumpy_file.parent
    assert f"{folder}: is a folder; one map, an npz, is required" in refused("view", folder)
    line = refused("view", bumpy_file)
    assert (
        f"is a mesh; its map, an npz, is required; type: gensp parameterize {bumpy_file}" in line
    )


def test_view_of_the_ply_of_a_map_names_its_npz(
    gensp: Run, refused: Refused, map_file: Path
) -> None:
    line = refused("view", map_file.with_suffix(".ply"))
    assert line.endswith(f"the npz beside it is required; name {map_file}")
    assert gensp("view", line.split("name ")[1], "--no-open")[0] == 0
    map_file.unlink()
    assert "type: gensp parameterize" in refused("view", map_file.with_suffix(".ply"))


def _maps(folder: Path, map: SphericalMap) -> dict[str, Path]:
    """Files that are no maps, each for its own reason."""
    arrays = {"vertices": map.surface, "faces": map.faces, "sphere": map.sphere}
    wrong = {
        "short": {"sphere": map.sphere[:-1]},
        "long": {"sphere": 2 * map.sphere},
        "nan": {"sphere": map.sphere * np.nan},
        "far": {"faces": map.faces + 1000},
        "real": {"faces": map.faces * 1.0},
        "doubtful": {"reliability": np.full(len(map.sphere), 2.0)},
        "doubted": {"reliability": np.ones(3)},
        "open": {"faces": map.faces[1:]},
        "repeated": {"faces": np.concatenate([map.faces, map.faces[:1]])},
        "islands": {
            "faces": np.concatenate([map.faces, map.faces + len(map.sphere)]),
            **{name: np.tile(arrays[name], (2, 1)) for name in ("vertices", "sphere")},
        },
        "spare": {name: np.resize(arrays[name], (643, 3)) for name in ("vertices", "sphere")},
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
        (["parameterize", "{mesh}", "--method", "magic"], "one of dirichlet, stretch, "),
        (["parameterize", "{mesh}", "--checkpoint", "no.pt"], "no.pt: does not exist"),
        (["parameterize", "{mesh}", "--register"], "--model is required"),
        (["parameterize", "{mesh}", "--model", "a.pt", "--method", "cmcf"], "leave one out"),
        (["parameterize", "{mesh}", "--geometry-image", "1"], "parameterize --help"),
        (["parameterize", "{mesh}", "--colour"], "parameterize --help"),
        (["morph", "{mesh}", "{mesh}", "--up", "w"], "one of x, y, z"),
        (["match", "{mesh}"], "Missing argument 'b'; see gensp match --help"),
        (["paint"], "No such command 'paint'; see gensp --help"),
    ],
)
def test_wrong_words_are_told_in_one_line(
    refused: Refused, bumpy_file: Path, words: list[str], told: str
) -> None:
    assert told in refused(*[word.format(mesh=bumpy_file) for word in words])
