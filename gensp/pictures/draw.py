"""All pictures of one evaluation and its page, from the folders that the stages left."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gensp.errors import MissingStage
from gensp.files import load_npz, read_json
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.layout import item_file
from gensp.pictures import sheets
from gensp.pictures.comparing import matching, side_by_side
from gensp.pictures.curves import error_curves, loss_curves, read_history, save_figure
from gensp.pictures.latent import latent_map
from gensp.pictures.material import Generated, Material, NotDrawn, PictureOptions, Truth
from gensp.pictures.montage import save_png
from gensp.pictures.render import up_axis
from gensp.pictures.report import Page, write_report
from gensp.pictures.strips import flow_strips, morph_strips, prediction_strips, tree_strips
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


# Kind, sentence for the page, function. The page shows them in this order.
KINDS: tuple[tuple[str, str, Callable[[Material], list[Path]]], ...] = (
    ("Collection", "One texture on the sphere, carried to every shape by its map.", contact_sheet),
    (
        "Morphs",
        "The generator from the sphere to the shape, g(t·z) for t from 0 to 1.",
        morph_strips,
    ),
    (
        "Morphs along the tree",
        "The generator from the sphere to the shape, through the nodes of the tree on the way.",
        tree_strips,
    ),
    ("Predictions", "What the generator makes of an input, and the final map.", prediction_strips),
    ("Flows", "Stage I: from a shape to the sphere.", flow_strips),
    ("Latent space", "Codes relative to the sphere's; registered edges are dark.", latents),
    ("Losses", "Means over the epoch; broken: validation shapes on the way.", losses),
    ("Errors", "Implied correspondence against ground truth.", errors),
    (
        "Matching",
        "Colours of the first shape on others, through the sphere and without any rotation; "
        "below, the error where there is ground truth.",
        matching,
    ),
    (
        "Side by side",
        "The same texture through these maps, and through those of the best methods of this "
        "experiment that learn nothing and fold nothing.",
        side_by_side,
    ),
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
    generated: Generated | None = None,
    truth: Truth | None = None,
    others: Mapping[str, Path] | None = None,
    settings: Mapping[str, Any] | None = None,
    options: PictureOptions | None = None,
) -> Drawn:
    """Draw what an evaluation has material for, and the page that shows it.

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
    generated, truth, others
        Surfaces that a generator made; where two shapes, given by name, have the same points;
        other methods' folders of stage parameterize, by the names that are shown.
    settings
        The configuration, shown in the page.

    Raises
    ------
    MissingStage
        There is not one map to draw.
    """
    options = options or PictureOptions()
    title, maps = " · ".join(filter(None, (collection, method))), _maps(runs, splits)
    shown = generated or Generated(), truth, others or {}
    material = Material(folder, runs, splits, title, summary, options, maps, *shown)
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
