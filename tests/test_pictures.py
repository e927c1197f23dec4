"""Pictures: a texture without seam, a renderer that shows what is there, a page that is whole."""

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gensp.errors import MissingStage, Unsupported
from gensp.files import save_npz, write_json, write_text
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.sphere import icosphere, sample_sphere, unit
from gensp.geometry.spherical_map import SphericalMap, save_map
from gensp.pictures import PictureOptions, draw_all
from gensp.pictures.curves import error_curves, loss_curves, read_history
from gensp.pictures.draw import tree_edges
from gensp.pictures.latent import principal_plane
from gensp.pictures.material import Generated, Material
from gensp.pictures.montage import Tile, grid
from gensp.pictures.rasterize import rasterize
from gensp.pictures.render import Scene, look
from gensp.pictures.sheets import (
    LARGE,
    Way,
    columns_for,
    contact_sheet,
    distortion_colours,
    flow_tiles,
    icosphere_level,
    morph_tiles,
    textured_sphere,
)
from gensp.pictures.strips import side_by_side
from gensp.pictures.texture import LINE_COLOUR, cube_map, hue_field, sphere_texture, to_bytes
from gensp.pictures.worst import worst_shapes

WHITE = 255


# --- texture ---------------------------------------------------------------------------------


def test_antipodes_never_share_a_colour(rng):
    p = sample_sphere(20_000, rng)
    assert np.abs(hue_field(p) - hue_field(-p)).max(axis=1).min() > 0.15


def test_axis_ends_have_their_own_colour():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    colours = hue_field(axes)
    distance = np.abs(colours[:, None] - colours[None]).max(axis=2) + np.eye(6)
    assert distance.min() > 0.2


def test_hues_have_no_seam(rng):
    # The gradient is bounded everywhere, so no step of 1e-4 may change a colour by more than 1e-3.
    p = sample_sphere(20_000, rng)
    p[:2_000, rng.integers(0, 3)] = 0  # on the planes where the mixture changes its colours
    p = unit(p)
    near = unit(p + 1e-4 * sample_sphere(len(p), rng))
    assert np.abs(hue_field(p) - hue_field(near)).max() < 1e-3


def test_cells_are_those_of_the_icosphere():
    centres = icosphere(3).vertices
    colours = sphere_texture(centres)
    np.testing.assert_allclose(colours[12:], hue_field(centres)[12:])
    edges = icosphere(3).edges
    middle = unit(centres[edges].mean(axis=1))
    np.testing.assert_allclose(sphere_texture(middle), np.broadcast_to(LINE_COLOUR, middle.shape))


def test_cube_map_is_the_texture():
    size = 33
    strip = cube_map(size)
    assert strip.shape == (6 * size, size, 3)
    centres = strip.reshape(6, size, size, 3)[:, size // 2, size // 2]
    axes = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_array_equal(centres, to_bytes(sphere_texture(axes.astype(float))))


# --- renderer --------------------------------------------------------------------------------


def quad(z: float, half: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half + [0, 0, z]
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])


def test_square_covers_exactly_its_pixels():
    vertices, faces = quad(0.0)
    fragments = rasterize(vertices, faces, 40)
    rows, columns = np.divmod(fragments.pixel, 40)
    assert len(fragments.pixel) == len(np.unique(fragments.pixel)) == 20 * 20
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (10, 29, 10, 29)


@pytest.mark.parametrize("order", [(0.3, -0.3), (-0.3, 0.3)])
def test_nearest_triangle_wins(order):
    (a, faces), (b, _) = quad(order[0]), quad(order[1], half=0.25)
    fragments = rasterize(np.concatenate([a, b]), np.concatenate([faces, faces + 4]), 40)
    front = fragments.face >= 2
    assert front.sum() == (100 if order[1] > order[0] else 0)
    np.testing.assert_allclose(fragments.depth[front], order[1], atol=1e-6)


def test_interpolation_is_affine(rng):
    vertices, faces = quad(0.0, half=0.9)
    fragments = rasterize(vertices, faces, 50)
    rows, columns = np.divmod(fragments.pixel, 50)
    seen = fragments.interpolate(vertices, faces)
    np.testing.assert_allclose(seen[:, 0], (columns + 0.5) / 25 - 1, atol=1e-5)
    np.testing.assert_allclose(seen[:, 1], 1 - (rows + 0.5) / 25, atol=1e-5)


def test_portions_do_not_change_the_picture(bumpy, monkeypatch):
    view = look().fitted(bumpy.vertices)
    whole = Scene(bumpy, view, 60).textured(unit(bumpy.vertices))
    monkeypatch.setattr("gensp.pictures.rasterize.CANDIDATES", 500)
    np.testing.assert_array_equal(Scene(bumpy, view, 60).textured(unit(bumpy.vertices)), whole)


def test_far_side_of_a_closed_surface_is_never_seen(dumbbell):
    view = look().fitted(dumbbell.vertices)
    p = unit(dumbbell.vertices)
    np.testing.assert_array_equal(
        Scene(dumbbell, view, 80).textured(p), Scene(dumbbell, view, 80, closed=True).textured(p)
    )


def test_silhouette_of_a_ball_is_a_disc():
    ball = icosphere(4)
    picture = Scene(ball, look().fitted(ball.vertices), 100).by_vertex(np.full((2562, 3), 0.5))
    ticks = (np.arange(100) + 0.5) / 50 - 1
    radius = np.hypot(*np.meshgrid(ticks, ticks))
    drawn = (picture < WHITE).any(axis=2)
    assert drawn[radius < 0.85].all()
    assert not drawn[radius > 0.91].any()


def test_view_puts_up_at_the_top_and_the_front_to_the_eye():
    for up, front in (("y", 2), ("z", 0), ("x", 1)):
        view = look(up, azimuth=0, elevation=0)
        np.testing.assert_allclose(view.rotation @ view.rotation.T, np.eye(3), atol=1e-12)
        assert np.isclose(np.linalg.det(view.rotation), 1)
        np.testing.assert_allclose(view.rotation[1], np.eye(3)["xyz".index(up)], atol=1e-12)
        np.testing.assert_allclose(view.rotation[2], np.eye(3)[front], atol=1e-12)
    np.testing.assert_allclose(look("-y", elevation=0).rotation[1], [0, -1, 0], atol=1e-12)


def test_picture_follows_the_map_and_not_the_vertices(bumpy, rng):
    # Another numbering of the same vertices is the same picture.
    view, p = look().fitted(bumpy.vertices), unit(bumpy.vertices)
    order = rng.permutation(len(p))
    place = np.argsort(order)
    shuffled = Mesh(bumpy.vertices[order], place[bumpy.faces])
    np.testing.assert_array_equal(
        Scene(bumpy, view, 60).textured(p), Scene(shuffled, view, 60).textured(p[order])
    )


def test_turned_map_from_the_front_is_the_map_from_behind():
    # The half-turn is a symmetry of the icosphere, so the two pictures have the same triangles.
    ball = icosphere(4)
    half_turn = np.diag([-1.0, 1.0, -1.0])
    pictures = [
        Scene(ball, look(azimuth=azimuth, elevation=0).fitted(ball.vertices), 80).textured(p)
        for azimuth, p in ((0, ball.vertices @ half_turn.T), (180, ball.vertices))
    ]
    differs = np.abs(pictures[0].astype(int) - pictures[1]).max(axis=2) > 8
    assert differs.mean() < 0.01


# --- sheets ----------------------------------------------------------------------------------


def test_distortion_colours_mark_folds():
    colours = distortion_colours(
        np.array([1.0, 2.0, np.inf, 1.0]), np.array([False, False, False, True])
    )
    assert len(np.unique(colours, axis=0)) == 4
    assert colours[3, 2] > colours[3, :2].max()


def test_grid_places_every_tile():
    tiles = [Tile(np.full((50, 50, 3), 40 * k, dtype=np.uint8), f"tile {k}") for k in range(5)]
    sheet = np.asarray(grid(tiles, 3))
    assert sheet.shape[1] == 150
    row = sheet.shape[0] // 2
    for k in range(5):
        assert (sheet[row * (k // 3) + 10, 50 * (k % 3) + 10] == 40 * k).all()


def test_large_collections_fit_a_sheet_of_bounded_width():
    tiles = [Tile(np.full((300, 300, 3), 90, dtype=np.uint8), str(k)) for k in range(700)]
    sheet = contact_sheet(tiles, tiles[0].image, "many")
    assert 3000 < sheet.width <= 4000


def test_captions_of_many_shapes_are_large():
    assert [columns_for(count) for count in (1, 3, 31, 41, 89, 700)] == [1, 2, 7, 8, 10, 25]
    tiles = [Tile(np.full((200, 200, 3), 255, dtype=np.uint8), "name") for _ in range(2)]
    heights = []
    for lines in (26, LARGE):
        ink = (np.asarray(grid(tiles, 2, lines=lines)) < 200).any(axis=(1, 2))
        heights.append(ink.sum())
    assert heights[1] > heights[0]


def test_many_strips_stand_two_beside_each_other():
    rows = [[Tile(np.zeros((2, 2, 3), dtype=np.uint8), f"{k}")] for k in range(5)]
    found = [[tile.caption for tile in row] for row in side_by_side(rows)]
    assert found == [["0", "3"], ["1", "4"], ["2"]]


def test_strips_begin_and_end_where_they_should():
    ball = icosphere(3)
    ellipsoid = ball.vertices * np.array([1.5, 1.0, 0.7])
    steps = np.linspace(0, 1, 12)[:, None, None]
    flow = (1 - steps) * ellipsoid + steps * ball.vertices
    view = look()
    morph = morph_tiles([Mesh(v, ball.faces) for v in flow[::-1]], "e", view, 60)
    strip = flow_tiles(flow, ball.faces, "e", view, 60, 3)
    assert (morph[0].caption, morph[-1].caption) == ("t = 0.00", "t = 1.00")
    assert (strip[0].caption, strip[-1].caption) == ("step 0", "step 11")
    np.testing.assert_array_equal(strip[0].image, morph[-1].image)


def test_morph_of_another_triangulation_is_refused(bumpy):
    assert icosphere_level(icosphere(2).faces) == 2
    with pytest.raises(Unsupported, match="triangulation of an icosphere"):
        icosphere_level(bumpy.faces[:, [1, 2, 0]])


# --- curves and latent space -----------------------------------------------------------------


def test_loss_curves_draw_every_term(tmp_path):
    write_text(
        tmp_path / "history.csv",
        "epoch,step,train/sdf,train/bend,train/x_share\n0,1,1.0,,\n1,2,0.5,0.6,1\n",
    )
    history = read_history(tmp_path / "history.csv")
    assert np.isnan(history["train/bend"][0])
    panel = loss_curves({"implicit": history}).axes[0]
    assert {line.get_label() for line in panel.lines} == {"sdf", "bend"}
    np.testing.assert_allclose(panel.lines[0].get_ydata(), [1.0, 0.5])


def test_error_curves_draw_every_kind():
    lines = {"raw": [0, 0.5], "rotated": [0, 0.6], "registered": [0, 0.55]}
    panel = error_curves({"thresholds": [0, 0.01], "test": lines}).axes[0]
    labels = [line.get_label() for line in panel.lines]
    assert labels == ["test", "test, best rotation", "test, registered"]
    np.testing.assert_array_equal(panel.lines[2].get_ydata(), lines["registered"])


def test_principal_plane_finds_the_plane(rng):
    basis = np.linalg.qr(rng.standard_normal((6, 2)))[0]
    flat = rng.standard_normal((40, 2)) * [3, 1]
    flat -= flat.mean(axis=0)
    plane, share = principal_plane(flat @ basis.T)
    assert np.isclose(share.sum(), 1)
    distances = [np.linalg.norm(x[:, None] - x[None], axis=2) for x in (flat, plane)]
    np.testing.assert_allclose(*distances, atol=1e-9)


def test_tree_edges_name_parents():
    parents, used = tree_edges(
        {"ids": ["sphere", "a", "b"], "parent": [-1, 0, 1], "used": [True, True, False]}
    )
    assert parents == {"a": "sphere", "b": "a"}
    assert used == {"sphere", "a"}


# --- all of it -------------------------------------------------------------------------------


OPTIONS = PictureOptions(
    tile=48, frames=3, strips=1, tree_strips=1, matches=1, turning=2, turning_faces=400, jobs=1
)
SUMMARY = {
    "variant": "full",
    "method": "gensp",
    "groups": {"test": {"shapes": 1, "sigma_mean": 1.234, "bad_faces_percent": 0.0}},
    "curves": {"thresholds": [0, 0.01], "test": {"raw": [0, 1], "rotated": [0, 1]}},
    "skipped": [{"id": "torn <b>", "reason": "open"}],
}


@pytest.fixture
def maps(tmp_path, monkeypatch, bumpy, ellipsoid) -> dict[str, str]:
    monkeypatch.setattr("gensp.pictures.report.TEXTURE_SIZE", 48)
    for mesh in (bumpy, ellipsoid):
        map = SphericalMap(unit(mesh.vertices), mesh.vertices, mesh.faces, mesh.name)
        save_map(map, tmp_path / "parameterize" / "maps")
    return {"bumpy": "train", "ellipsoid": "test", "failed": "test"}


def add_training(folder: Path) -> dict[str, Path]:
    ball = icosphere(2)
    times = np.linspace(0, 1, 5)[:, None, None]
    flow = (1 + 0.3 * (1 - times) * ball.vertices[:, :1]) * ball.vertices
    save_npz(folder / "augment/flows/bumpy.npz", vertices=flow, faces=ball.faces)
    predicted = folder / "parameterize/predictions/ellipsoid.npz"
    save_npz(predicted, sphere=ball.vertices, generated=flow[0])
    codes = np.random.default_rng(0).standard_normal((2, 4))
    save_npz(folder / "implicit/latents.npz", ids=np.array(["bumpy", "bumpy@0"]), codes=codes)
    tree = {"ids": ["sphere", "bumpy", "bumpy@0"], "parent": [-1, 2, 0], "used": [1, 1, 1]}
    write_json(folder / "correspond/tree.json", tree)
    write_text(folder / "implicit/history.csv", "epoch,step,train/sdf\n0,1,1.0\n1,2,0.5\n")
    return {name: folder / name for name in ("augment", "implicit", "correspond")}


def corners(first: str, second: str) -> tuple[SurfacePoints, SurfacePoints, bool]:
    """Vertices of both shapes that are the same."""
    at = SurfacePoints(np.arange(40), np.eye(3)[np.zeros(40, dtype=int)])
    return at, at, False


class Sources(HTMLParser):
    """Every address that a page names, and the number of its pictures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        names = ("src", "href", "srcset", "action", "data")
        self.addresses += [value for name, value in attributes if name in names]


def test_everything_is_drawn_and_the_page_needs_no_network(tmp_path, maps):
    runs = {"parameterize": tmp_path / "parameterize", **add_training(tmp_path)}
    rows = "id,sigma_mean,sigma_max,error\nbumpy,1.5,3,\nellipsoid,1.9,2,0.02\nfailed,9,9,1\n"
    write_text(tmp_path / "evaluate" / "shapes.csv", rows)
    ball = icosphere(1)
    morph = [Mesh(ball.vertices * s, ball.faces) for s in (1.0, 1.2)]
    ways = {"ellipsoid": Way(morph, ["bumpy", "ellipsoid"])}
    drawn = draw_all(
        tmp_path / "evaluate",
        runs=runs,
        splits=maps,
        collection="toys",
        method="full",
        summary=SUMMARY,
        generated=Generated({"ellipsoid": morph}, ways),
        truth=corners,
        others={"other": tmp_path / "parameterize"},
        settings={"source": "https://example.org"},
        options=OPTIONS,
    )
    assert drawn.not_drawn == {}
    files = [path for paths in drawn.pictures.values() for path in paths]
    for path in files:
        with Image.open(path) as picture:
            assert np.asarray(picture.convert("L")).std() > 5, path.name
    text = drawn.report.read_text(encoding="utf-8")
    addresses = Sources(text).addresses
    assert len(addresses) == len(files) + 1  # the texture of the shapes that turn
    assert all(address.startswith("data:image/") for address in addresses)
    outside_text = re.sub(r"<pre>.*?</pre>", "", text, flags=re.DOTALL)
    assert not re.search(r"https?://|url\(|@import|fetch\(|XMLHttpRequest", outside_text)
    assert "{{" not in text
    assert "1.234" in text
    assert "torn &lt;b&gt;" in text
    assert len(text) < 3e6


def test_the_worst_are_told_by_each_figure(tmp_path, bumpy, ellipsoid):
    rows = "id,sigma_mean,error\nbumpy,1.5,0.3\nellipsoid,1.9,0.2\nfailed,9,9\neven,,\n"
    write_text(tmp_path / "shapes.csv", rows)
    maps = {
        mesh.name: SphericalMap(unit(mesh.vertices), mesh.vertices, mesh.faces, mesh.name)
        for mesh in (bumpy, ellipsoid)
    }
    material = Material(tmp_path, {}, {}, "toys", None, OPTIONS, maps)
    assert material.worst("sigma_mean", 5) == ["ellipsoid", "bumpy"]
    assert material.worst("error", 1) == ["bumpy"]
    (path,) = worst_shapes(material)
    assert path == tmp_path / "pictures" / "worst.png"


def test_a_baseline_names_what_is_not_drawn(tmp_path, maps):
    drawn = draw_all(
        tmp_path / "evaluate",
        runs={"parameterize": tmp_path / "parameterize"},
        splits=maps,
        collection="toys",
        method="cmcf",
        options=OPTIONS,
    )
    assert set(drawn.pictures) == {"Collection", "Distortion", "Shape by shape"}
    assert drawn.not_drawn["Flows"] == "this run has no stage augment"
    assert drawn.not_drawn["Morphs"] == "this method has no generator"
    assert "ground truth" in drawn.not_drawn["Matching"]
    assert "learns nothing" in drawn.not_drawn["Side by side"]
    for reason in drawn.not_drawn.values():
        assert reason in drawn.report.read_text(encoding="utf-8")


def test_same_run_gives_the_same_page(tmp_path, maps):
    runs = {"parameterize": tmp_path / "parameterize"}
    first, second = (
        draw_all(tmp_path / name, runs=runs, splits=maps, collection="toys", options=OPTIONS)
        for name in ("one", "two")
    )
    assert first.report.read_bytes() == second.report.read_bytes()
    for kind, paths in first.pictures.items():
        for a, b in zip(paths, second.pictures[kind], strict=True):
            assert a.read_bytes() == b.read_bytes()


def test_no_map_names_the_stage(tmp_path):
    with pytest.raises(MissingStage, match="stage=parameterize"):
        draw_all(
            tmp_path, runs={"parameterize": tmp_path}, splits={"a": "test"}, collection="toys"
        )


def test_unseen_shapes_are_chosen_first():
    splits = {f"s{k}": "train" for k in range(9)} | {"a": "test", "b": "test", "c": "val"}
    assert PictureOptions(strips=2).chosen(splits) == ["a", "b"]
    assert PictureOptions(strips=12).chosen(splits)[:3] == ["a", "b", "c"]
    assert len(PictureOptions().chosen(splits, 100)) == 12


def test_textured_sphere_shows_many_colours():
    picture = textured_sphere(look(), 60)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200
