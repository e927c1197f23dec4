"""Wavefront OBJ with enough digits, with or without a texture."""

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from gensp.files import atomic_path, write_text
from gensp.geometry.texture_coordinates import Unwrapped

# Seventeen significant digits give back every double: fewer could fold tiny faces.
_DIGITS = "%.17g"


def write_obj(
    path: Path, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> None:
    """Write positions and triangles; reading the file gives the same doubles."""
    write_text(path, _rows("v", vertices, _DIGITS) + _rows("f", faces + 1, "%d"))


def write_textured_obj(
    path: Path, surface: Unwrapped, picture: UInt8[np.ndarray, "h w 3"]
) -> None:
    """Write an OBJ, its MTL and its PNG, named alike, side by side."""
    png, mtl = path.with_suffix(".png"), path.with_suffix(".mtl")
    with atomic_path(png) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")
    write_text(mtl, f"newmtl sphere\nKd 1 1 1\nmap_Kd {png.name}\n")
    # Positions are named once, so that the file is still a closed surface.
    whole, place = surface.whole()
    corners = np.stack([place[surface.faces], surface.faces], axis=2) + 1
    head = f"mtllib {mtl.name}\n"
    points = _rows("v", whole.vertices, _DIGITS) + _rows("vt", surface.uv, "%.9g")
    triangles = _rows("f", corners.reshape(-1, 6), " ".join(["%d/%d"] * 3), whole=True)
    write_text(path, head + points + "usemtl sphere\n" + triangles)


def _rows(word: str, table: np.ndarray, number: str, *, whole: bool = False) -> str:
    form = number if whole else " ".join([number] * table.shape[1])
    text = io.StringIO()
    np.savetxt(text, table, fmt=f"{word} {form}")
    return text.getvalue()
