"""Tiles with captions, set side by side into one picture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import get_data_path
from matplotlib.colors import Colormap
from PIL import Image, ImageDraw, ImageFont

from gensp.files import atomic_path
from gensp.pictures.texture import to_bytes

INK, FAINT = (38, 40, 48), (120, 124, 136)
SPLIT_COLOURS = {"train": (92, 107, 138), "val": (214, 140, 24), "test": (200, 48, 64)}


@dataclass(frozen=True)
class Tile:
    """A picture with a caption, a fainter second line, and a mark for its split."""

    image: UInt8[np.ndarray, "h w 3"]
    caption: str = ""
    note: str = ""
    split: str = ""


@lru_cache(maxsize=16)
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings along: it has Greek letters, on every machine."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / name), size)


def resized(tile: Tile, side: int) -> Tile:
    """The tile with a picture of another size."""
    if len(tile.image) == side:
        return tile
    picture = Image.fromarray(tile.image).resize((side, side), Image.Resampling.LANCZOS)
    return replace(tile, image=np.asarray(picture))


def grid(
    tiles: Sequence[Tile], columns: int, *, title: str = "", note: str = "", lines: int = 26
) -> Image.Image:
    """Tiles in rows of `columns`, captions below each, a title above all.

    `lines` of a caption are as high as a tile.
    """
    height, width = tiles[0].image.shape[:2]
    text, small = (max(11, round(width / count)) for count in (26, lines))
    captions = round(small * (3.4 if any(tile.note for tile in tiles) else 2.0))
    if not any(tile.caption or tile.note for tile in tiles):
        captions = 0
    head = round(text * 4.2) if title else 0
    rows = -(-len(tiles) // columns)
    sheet = Image.new("RGB", (columns * width, head + rows * (height + captions)), "white")
    pen = ImageDraw.Draw(sheet)
    if title:
        pen.text((text, text * 0.6), title, fill=INK, font=font(round(text * 1.5), bold=True))
        pen.text((text, text * 2.6), note, fill=FAINT, font=font(text))
    for index, tile in enumerate(tiles):
        row, column = divmod(index, columns)
        corner = (column * width, head + row * (height + captions))
        sheet.paste(Image.fromarray(tile.image), corner)
        _caption(pen, tile, (corner[0] + width // 2, corner[1] + height), small, width)
    return sheet


def _caption(
    pen: ImageDraw.ImageDraw, tile: Tile, at: tuple[int, int], text: int, width: int
) -> None:
    main = _clipped(tile.caption, font(text), width - 3 * text)
    pen.text(at, main, fill=INK, font=font(text), anchor="ma")
    if tile.split in SPLIT_COLOURS:
        left = at[0] - font(text).getlength(main) / 2 - 1.1 * text
        box = (left, at[1] + 0.35 * text, left + 0.6 * text, at[1] + 0.95 * text)
        pen.ellipse(box, fill=SPLIT_COLOURS[tile.split])
    small = font(max(10, round(text * 0.85)))
    pen.text((at[0], at[1] + 1.5 * text), tile.note, fill=FAINT, font=small, anchor="ma")


def _clipped(text: str, face: ImageFont.FreeTypeFont, width: float) -> str:
    if face.getlength(text) <= width:
        return text
    while text and face.getlength(text + "…") > width:
        text = text[:-1]
    return text + "…"


def rows_of(rows: Sequence[Sequence[Tile]], *, title: str = "", note: str = "") -> Image.Image:
    """Rows of tiles; shorter rows are filled with white."""
    columns = max(len(row) for row in rows)
    blank = Tile(np.full_like(rows[0][0].image, 255))
    filled = [tile for row in rows for tile in [*row, *[blank] * (columns - len(row))]]
    return grid(filled, columns, title=title, note=note)


def colour_bar(
    sheet: Image.Image, colours: Colormap, ticks: Sequence[tuple[float, str]], label: str
) -> Image.Image:
    """The sheet with a horizontal legend below; ticks are (place in [0, 1], text)."""
    text = max(11, sheet.width // 90)
    wide = Image.new("RGB", (sheet.width, sheet.height + 5 * text), "white")
    wide.paste(sheet, (0, 0))
    left, length, top = sheet.width // 4, sheet.width // 2, sheet.height + text
    ramp: Float[np.ndarray, "w 3"] = colours(np.linspace(0, 1, length))[:, :3]
    wide.paste(Image.fromarray(np.repeat(to_bytes(ramp)[None], text, axis=0)), (left, top))
    pen = ImageDraw.Draw(wide)
    for place, words in ticks:
        at = (left + place * length, top + 1.3 * text)
        pen.text(at, words, fill=INK, font=font(text), anchor="ma")
    pen.text((left - text, top), label, fill=INK, font=font(text), anchor="ra")
    return wide


def save_png(picture: Image.Image, path: Path) -> Path:
    """Write a picture whole or not at all; the same picture gives the same bytes."""
    with atomic_path(path) as temporary:
        picture.save(temporary, format="PNG", optimize=False, compress_level=6)
    return path
