"""The work of `gensp transfer`: what is read, carried and written."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gensp.cli.pairs import Pair
from gensp.cli.terminal import written
from gensp.errors import DamagedFile, MissingData, UnreadableMesh, Unsupported
from gensp.export.baking import baked_picture, read_textured
from gensp.export.polygons import write_ply
from gensp.export.textured import write_textured
from gensp.files import load_npz, save_npz
from gensp.geometry.transfer import transfer


def require_one(attribute: str | None, texture: Path | None) -> None:
    """Refuse to carry nothing, or two things at once.

    Raises
    ------
    Unsupported
        Both are given, or neither.
    """
    if attribute is not None and texture is not None:
        raise Unsupported(
            "transfer: --attribute and --texture together; one of them is required; leave one out"
        )
    if attribute is None and texture is None:
        raise Unsupported(
            "transfer: nothing to carry; --attribute FILE.npz:NAME or --texture FILE is required; "
            "add one"
        )


def transfer_texture(pair: Pair, path: Path, out: Path, height: int) -> list[Path]:
    """Bake the source's texture and dress the target in it."""
    picture = baked_picture(read_textured(path), pair.a, height, pair.rotation)
    return write_textured(pair.b, picture, out)


def transfer_attribute(pair: Pair, attribute: str, out: Path) -> list[tuple[str, str]]:
    """Carry one array from vertices to vertices; returns what is to be told."""
    name, values = _read(attribute)
    carried = transfer(values, pair.a, pair.b, pair.rotation)
    if out.suffix.lower() == ".npz":
        save_npz(out, **{name: carried})
    elif out.suffix.lower() == ".ply":
        _write_colours(pair, carried, out)
    else:
        raise Unsupported(
            f"{out}: format '{out.suffix}' is not written; .npz, or .ply for colours, is "
            "required; name another file"
        )
    return [*_unknown(values, carried), written([out])]


def _unknown(values: np.ndarray, carried: np.ndarray) -> list[tuple[str, str]]:
    """How many rows hold what is no number: such spread to every face that they touch."""
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return []
    before, after = (_not_finite(rows) for rows in (values, carried))
    return [("not finite", f"{before} of {len(values)} vertices → {after} of {len(carried)}")]


def _not_finite(rows: np.ndarray) -> int:
    return int((~np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)).sum())


def _write_colours(pair: Pair, colours: np.ndarray, out: Path) -> None:
    if colours.dtype != np.uint8 or colours.ndim != 2 or colours.shape[1] not in (3, 4):
        raise Unsupported(
            f"{out}: values {colours.shape} of {colours.dtype} are no colours; a PLY takes 3 or 4 "
            "bytes a vertex; name an .npz"
        )
    write_ply(out, pair.b.mesh, colours)


def _read(attribute: str) -> tuple[str, np.ndarray]:
    """Name and values of FILE.npz:NAME, or the vertex colours of a PLY."""
    if attribute.lower().endswith(".ply"):
        return "colours", _colours(Path(attribute))
    file, _, name = attribute.rpartition(":")
    path = Path(file)
    if not path.is_file() or path.suffix.lower() != ".npz":
        raise MissingData(
            f"{attribute}: names no array; FILE.npz:NAME or a PLY with vertex colours is "
            "required; correct --attribute"
        )
    try:
        arrays = load_npz(path)
    except (OSError, DamagedFile) as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}); an npz of plain arrays is "
            "required; write it again"
        ) from error
    if name not in arrays:
        there = ", ".join(arrays)
        raise MissingData(f"{path}: has no array '{name}'; it has {there}; name one of them")
    return name, arrays[name]


def _colours(path: Path) -> np.ndarray:
    try:
        visual: Any = trimesh.load(path, process=False, force="mesh", maintain_order=True).visual
    # Readers of damaged files raise whatever their parser met; the file is at fault in each case.
    except Exception as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}); a PLY with vertex colours is "
            "required; export it again"
        ) from error
    if visual.kind != "vertex":
        raise MissingData(f"{path}: has no vertex colours; they are required; name another file")
    return np.asarray(visual.vertex_colors, dtype=np.uint8)
