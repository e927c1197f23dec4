"""All pictures of one evaluation and its page, from the folders that the stages left."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gensp.errors import MissingStage
from gensp.files import load_npz, read_json
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.layout import item_file
from gensp.pictures import sheets
from gensp.pictures.curves import error_curves, loss_curves, read_history, save_figure
from gensp.pictures.latent import latent_map
from gensp.pictures.material import Material, NotDrawn, PictureOptions
from gensp.pictures.montage import Tile, save_png
from gensp.pictures.render import up_axis
from gensp.pictures.report import Page, write_report
from gensp.pictures.worst import worst_shapes

TRAINED = ("implicit", "initialize", "finetune")


@dataclass(frozen=True)
class Drawn:
    """What was drawn: files by kind, the page, and what could not be drawn, with the reason."""

    pictures: dict[str, list[Path]]
    report: Path
    not_drawn: dict[str, str]


def contact_sheet(material: Material) -> list[Path]:
    """The collection in one texture."""
    tiles = [material.tile(name, drawn.textured) for name, drawn in material.drawn_maps.items()]
    sheet = sheets.contact_sheet(tiles, material.sphere, material.title)
    return [save_png(sheet, material.pictures / "contact_sheet.png")]


def distortion_sheet(material: Material) -> list[Path]:
    """The collection painted by σ_t."""
    tiles = [material.tile(name, drawn.distorted) for name, drawn in material.drawn_maps.items()]
    sheet = sheets.distortion_sheet(tiles, f"{material.title} · isometric distortion σ")
    return [save_png(sheet, material.pictures / "distortion.png")]


def single_shapes(material: Material) -> list[Path]:
    """Sphere and shape side by side, a file for every shape."""
    return [
        save_png(
            sheets.map_strip(drawn, material.sphere, name, material.notes.get(name, " ")),
            item_file(material.folder, "pictures/shapes", name, ".png"),
        )
        for name, drawn in material.drawn_maps.items()
    ]


def morph_strips(material: Material) -> list[Path]:
    """The generator's surfaces on the way from the sphere to a shape."""
    if not material.morphs:
        raise NotDrawn("this method has no generator")
    size = material.strip_tile
    rows = sheets.together(
        lambda named: sheets.morph_tiles(named[1], named[0], material.view, size, material.place),
        material.morphs.items(),
        material.options.jobs,
    )
    return [_strips(material, rows, "morphs", "From the sphere to a shape", "g(t·z)")]


def flow_strips(material: Material) -> list[Path]:
    """Mean curvature flows of input shapes."""
    files = material.files("augment", "flows")
    found = {name: split for name, split in material.splits.items() if files[name].exists()}
    if not found:
        raise NotDrawn("stage augment left no flow of these shapes")
    size, frames = material.strip_tile, material.options.frames

    def strip(name: str) -> list[Tile]:
        flow = load_npz(files[name])
        vertices, faces = flow["vertices"].astype(np.float64), flow["faces"].astype(np.int64)
        return sheets.flow_tiles(vertices, faces, name, material.view, size, frames)

    rows = sheets.together(strip, material.options.chosen(found), material.options.jobs)
    note = "conformalised mean curvature flow, equal steps of arc length"
    return [_strips(material, rows, "flows", "From a shape to the sphere", note)]


def prediction_strips(material: Material) -> list[Path]:
    """Inputs beside the surfaces that the generator makes of them."""
    files = material.files("parameterize", "predictions")
    found = {name: material.splits[name] for name in material.maps if files[name].exists()}
    if not found:
        raise NotDrawn("this method keeps no prediction")
    rows = []
    for name in material.options.chosen(found):
        generated = load_npz(files[name]).get("generated")
        if generated is None:
            raise NotDrawn("the predictions hold no generated surface")
        pair = material.maps[name], generated.astype(np.float64)
        look = material.view, material.strip_tile, material.place
        rows.append(sheets.prediction_tiles(*pair, *look))
    return [_strips(material, rows, "predictions", "Generated surfaces", "input, g(·, z), map")]


def latents(material: Material) -> list[Path]:
    """The latent space with the tree."""
    stored = load_npz(material.artefact("implicit", "latents.npz"))
    tree_file = material.artefact("correspond", "tree.json")
    tree = read_json(tree_file)
    ids = [str(name) for name in stored["ids"]]
    parents, used = tree_edges(tree)
    drawing = latent_map(ids, stored["codes"], material.splits, parents, used)
    return [save_figure(drawing, material.pictures / "latents.png")]


def tree_edges(tree: Mapping[str, Any]) -> tuple[dict[str, str], frozenset[str]]:
    """Parent of every node but the root, and the children whose edge was registered.

    A parent is given by its place in the list of ids; the root's is negative.
    """
    ids = [str(name) for name in tree["ids"]]
    parents = {
        name: ids[place] for name, place in zip(ids, tree["parent"], strict=True) if place >= 0
    }
    marks = tree.get("used") or []
    return parents, frozenset(name for name, mark in zip(ids, marks, strict=False) if mark)


def losses(material: Material) -> list[Path]:
    """The losses of the training stages."""
    found = {s: material.runs[s] / "history.csv" for s in TRAINED if s in material.runs}
    histories = {s: read_history(path) for s, path in found.items() if path.is_file()}
    histories = {s: history for s, history in histories.items() if history}
    if not histories:
        raise NotDrawn("this run trained nothing")
    return [save_figure(loss_curves(histories), material.pictures / "losses.png")]


def errors(material: Material) -> list[Path]:
    """Implied-correspondence errors as the fraction below a threshold."""
    curves = (material.summary or {}).get("curves") or {}
    if not any(split != "thresholds" for split in curves):
        raise NotDrawn("the shapes have no ground truth in common")
    return [save_figure(error_curves(curves), material.pictures / "errors.png")]


def _strips(
    material: Material, rows: Sequence[Sequence[Tile]], file: str, title: str, note: str
) -> Path:
    picture: Image.Image = sheets.strips(rows, title, note)
    return save_png(picture, material.pictures / f"{file}.png")


# Kind, sentence for the page, function. The page shows them in this order.
KINDS: tuple[tuple[str, str, Callable[[Material], list[Path]]], ...] = (
    ("Collection", "One texture on the sphere, carried to every shape by its map.", contact_sheet),
    (
        "Morphs",
        "The generator from the sphere to the shape, g(t·z) for t from 0 to 1.",
        morph_strips,
    ),
    ("Predictions", "What the generator makes of an input, and the final map.", prediction_strips),
    ("Flows", "Stage I: from a shape to the sphere.", flow_strips),
    ("Latent space", "Codes relative to the sphere's; registered edges are dark.", latents),
    ("Losses", "Means over the epoch; broken: validation shapes on the way.", losses),
    ("Errors", "Implied correspondence against ground truth.", errors),
    ("Distortion", "Isometric distortion σ of every triangle.", distortion_sheet),
    (
        "Worst shapes",
        "By mean σ, and by mean error to the others, the largest first; painted by σ.",
        worst_shapes,
    ),
    ("Shape by shape", "", single_shapes),
)


def draw_all(
    folder: Path,
    *,
    runs: Mapping[str, Path],
    splits: Mapping[str, str],
    collection: str,
    method: str = "",
    summary: Mapping[str, Any] | None = None,
    morphs: Mapping[str, Sequence[Mesh]] | None = None,
    place: sheets.Place = sheets.unmoved,
    settings: Mapping[str, Any] | None = None,
    options: PictureOptions | None = None,
) -> Drawn:
    """Draw everything that an evaluation has material for, and the page that shows it.

    Parameters
    ----------
    folder
        The evaluation's, with shapes.csv for captions; gets pictures/ and report.html.
    runs
        Folders of the stages of this run; "parameterize" is required.
    splits
        Split of every shape, in the order of the sheets; shapes without a map are left out.
    collection, method, summary
        Words for the titles, and the figures of summary.json.
    morphs
        For a few shapes the generator's surfaces g(t·z), on an icosphere's triangles.
    place
        Where maps have the generator's points of the sphere (`gensp.models.atlas.Atlas.place`).
    settings
        The configuration, shown in the page.

    Raises
    ------
    MissingStage
        There is not one map to draw.
    """
    options = options or PictureOptions()
    title, maps = " · ".join(filter(None, (collection, method))), _maps(runs, splits)
    material = Material(folder, runs, splits, title, summary, morphs or {}, options, maps, place)
    pictures, not_drawn = _all_kinds(material)
    page = _page(material, pictures, not_drawn, settings or {})
    report = write_report(page, folder / "report.html", turning_faces=options.turning_faces)
    return Drawn(pictures, report, not_drawn)


def _all_kinds(material: Material) -> tuple[dict[str, list[Path]], dict[str, str]]:
    """Files by kind, and why the other kinds have none."""
    pictures: dict[str, list[Path]] = {}
    not_drawn: dict[str, str] = {}
    for kind, _, draw in KINDS:
        try:
            pictures[kind] = draw(material)
        except NotDrawn as reason:
            not_drawn[kind] = str(reason)
    return pictures, not_drawn


def _maps(runs: Mapping[str, Path], splits: Mapping[str, str]) -> dict[str, SphericalMap]:
    folder = runs["parameterize"]
    files = {name: item_file(folder, "maps", name) for name in splits}
    maps = {name: load_map(path) for name, path in files.items() if path.is_file()}
    if not maps:
        raise MissingStage(
            f"{folder / 'maps'}: holds no map of these {len(splits)} shapes; at least one is "
            "required; run stage=parameterize first"
        )
    return maps


def _page(
    material: Material,
    pictures: Mapping[str, list[Path]],
    not_drawn: Mapping[str, str],
    settings: Mapping[str, Any],
) -> Page:
    options, splits = material.options, {n: material.splits[n] for n in material.maps}
    turning = options.chosen(splits, options.turning)
    shown = [
        (kind, note, pictures[kind][: options.gallery])
        for kind, note, _ in KINDS
        if kind in pictures
    ]
    counts = [
        f"{list(splits.values()).count(split)} {word}"
        for split, word in (("train", "training"), ("val", "validation"), ("test", "test"))
    ]
    return Page(
        title=f"Spherical parameterizations · {material.title}",
        subtitle=f"{len(splits)} shapes: {', '.join(counts)}",
        summary=material.summary,
        pictures=shown,
        turning={f"{name} ({splits[name]})": material.maps[name] for name in turning},
        turn=material.view.rotation,
        up=up_axis(options.up).tolist(),
        not_drawn=not_drawn,
        settings=settings,
    )
