"""Rows of surfaces: from the sphere to shapes, from shapes to the sphere, generated ones."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from gensp.files import load_npz
from gensp.pictures import sheets
from gensp.pictures.material import Material, NotDrawn
from gensp.pictures.montage import Tile, save_png

_LONG = 12  # rows of a sheet; of more, two stand side by side


def morph_strips(material: Material) -> list[Path]:
    """The generator's surfaces on the way from the sphere to a shape."""
    if not material.generated.morphs:
        raise NotDrawn("this method has no generator")
    size = material.strip_tile
    rows = sheets.together(
        lambda named: sheets.morph_tiles(
            named[1], named[0], material.view, size, material.generated.place
        ),
        material.generated.morphs.items(),
        material.options.jobs,
    )
    return [_strips(material, rows, "morphs", "From the sphere to a shape", "g(t·z)")]


def tree_strips(material: Material) -> list[Path]:
    """The generator's surfaces on the way from the sphere to shapes along the tree."""
    if not material.generated.ways:
        raise NotDrawn("this method has no generator, or its run no tree")
    size = material.strip_tile
    rows = sheets.together(
        lambda named: sheets.way_tiles(
            named[1], named[0], material.view, size, material.generated.place
        ),
        material.generated.ways.items(),
        material.options.jobs,
    )
    note = "equal steps in latent space; below, the node of the tree that comes next"
    return [_strips(material, rows, "tree", "From the sphere to shapes, along the tree", note)]


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
        look = material.view, material.strip_tile, material.generated.place
        rows.append(sheets.prediction_tiles(*pair, *look))
    return [_strips(material, rows, "predictions", "Generated surfaces", "input, g(·, z), map")]


def _strips(
    material: Material, rows: Sequence[Sequence[Tile]], file: str, title: str, note: str
) -> Path:
    if len(rows) > _LONG:
        rows = side_by_side(rows)
    picture: Image.Image = sheets.strips(rows, title, note)
    return save_png(picture, material.pictures / f"{file}.png")


def side_by_side(rows: Sequence[Sequence[Tile]]) -> list[list[Tile]]:
    """Half as many rows: to the right of every one, the one that many further on."""
    half = -(-len(rows) // 2)
    return [[*rows[k], *(rows[half + k] if half + k < len(rows) else [])] for k in range(half)]
