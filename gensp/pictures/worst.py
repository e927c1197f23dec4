"""The shapes that an evaluation is least content with."""

from pathlib import Path

from gensp.pictures import sheets
from gensp.pictures.material import Material, NotDrawn
from gensp.pictures.montage import Tile, resized, save_png

# What a shape may be worst in: column of shapes.csv, words.
_FIGURES = (("sigma_mean", "largest mean σ"), ("error", "largest mean error"))


def worst_shapes(material: Material) -> list[Path]:
    """The shapes with the largest distortion, and with the largest error, painted by σ_t."""
    rows = {words: _worst(material, figure) for figure, words in _FIGURES}
    rows = {words: row for words, row in rows.items() if row}
    if not rows:
        raise NotDrawn("shapes.csv has no figures of these shapes")
    sheet = sheets.strips(list(rows.values()), "Worst shapes", " · ".join(rows))
    return [save_png(sheet, material.pictures / "worst.png")]


def _worst(material: Material, figure: str) -> list[Tile]:
    known = material.drawn_maps
    return [
        resized(material.tile(name, known[name].distorted), material.strip_tile)
        for name in material.worst(figure, material.options.frames)
    ]
