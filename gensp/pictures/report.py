"""One page that needs no network: the table, every picture, shapes that turn under the mouse."""

import base64
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from html import escape
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from gensp.columns import Column
from gensp.files import write_text
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.pictures.texture import cube_map
from gensp.tables import cell, columns_of

PACKAGES = ("gensp", "torch", "lightning", "numpy", "scipy", "libigl", "trimesh", "torchdiffeq")
CARDS = (
    "sigma_mean",
    "sigma_max",
    "error",
    "error_rotated",
    "error_registered",
    "c",
    "c_frame",
    "c_frame_registered",
    "bad_faces_percent",
    "seconds",
)
TEXTURE_SIZE = 512
PICTURE_WIDTH = 1800


@dataclass(frozen=True)
class Page:
    """What the page shows.

    Attributes
    ----------
    title, subtitle
        The head of the page.
    summary
        The evaluation, or None where there is none.
    pictures
        Sections of pictures: (heading, a sentence, files).
    turning
        Maps of the shapes that turn, each with its label.
    turn
        The view in which they begin: rows right, up, towards the eye.
    up
        The axis about which they turn.
    not_drawn
        Pictures that are missing, with the reason.
    settings
        The configuration of the run.
    """

    title: str
    subtitle: str
    summary: Mapping[str, Any] | None
    pictures: Sequence[tuple[str, str, Sequence[Path]]]
    turning: Mapping[str, SphericalMap]
    turn: Float[np.ndarray, "3 3"]
    up: Sequence[float] = (0, 1, 0)
    not_drawn: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)


def write_report(page: Page, path: Path, *, turning_faces: int = 20_000) -> Path:
    """Write the page: styles, script, pictures and shapes are all inside the one file."""
    shapes = [_shape(label, map, turning_faces) for label, map in page.turning.items()]
    data = {"turn": page.turn.tolist(), "up": list(page.up), "shapes": shapes}
    filled = {
        "title": escape(page.title),
        "subtitle": escape(page.subtitle),
        "style": _part("report.css"),
        "sections": "\n".join(_sections(page)),
        # A closing tag within the data would end the script element.
        "shapes": json.dumps(data).replace("</", "<\\/"),
        "script": _part("viewer.js"),
    }
    text = _part("report.html")
    for name, value in filled.items():
        text = text.replace("{{" + name + "}}", value)
    write_text(path, text)
    return path


def _part(name: str) -> str:
    return files("gensp.pictures").joinpath("page", name).read_text(encoding="utf-8")


def _sections(page: Page) -> Iterator[str]:
    if page.summary is not None:
        yield from _figures(page.summary)
    if page.turning:
        yield _viewer()
    for heading, note, paths in page.pictures:
        shown = "".join(f"<figure>{_image(path)}</figure>" for path in paths)
        kind = "gallery" if len(paths) > 1 else "wide"
        yield _section(heading, note, f'<div class="{kind}">{shown}</div>')
    yield from _left_out(page)
    yield _section("How it was made", "", _settings(page.settings))


def _section(heading: str, note: str, body: str) -> str:
    said = f'<p class="note">{escape(note)}</p>' if note else ""
    return f"<section><h2>{escape(heading)}</h2>{said}{body}</section>"


def _figures(summary: Mapping[str, Any]) -> Iterator[str]:
    columns = columns_of([summary])
    groups = summary["groups"]
    split = next((name for name in ("test", "all", *groups) if name in groups), "")
    cards = [_card(column, groups[split]) for column in columns if column.key in CARDS]
    body = f'<div class="cards">{"".join(cards)}</div>'
    yield _section(f"Figures of the {split} shapes", "", body)
    head = ["split", *(column.heading for column in columns)]
    rows = [
        [split, *(cell(group.get(column.key), column.digits) for column in columns)]
        for split, group in groups.items()
    ]
    legend = _table(["column", ""], [[c.heading, c.meaning] for c in columns], text=True)
    table = f'<div class="wide">{_table(head, rows)}</div>'
    note = summary.get("normalization") or ""
    yield _section("Table", note, f"{table}<details><summary>Columns</summary>{legend}</details>")


def _card(column: Column, group: Mapping[str, Any]) -> str:
    figure = cell(group.get(column.key), column.digits)
    return f'<div class="card" title="{escape(column.meaning)}"><b>{figure}</b><span>' + (
        f"{escape(column.heading)}</span></div>"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], *, text: bool = False) -> str:
    top = "".join(f"<th>{escape(word)}</th>" for word in head)
    kind = ' class="text"' if text else ""
    body = "".join(
        "<tr>" + "".join(f"<td{kind}>{escape(word)}</td>" for word in row) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _viewer() -> str:
    pane = '<div class="pane"><canvas></canvas><select aria-label="shape"></select></div>'
    controls = (
        '<div class="controls"><label>shape <input id="morph" type="range" min="0" max="1" '
        'step="0.01" value="0"> sphere</label><label><input id="spin" type="checkbox" checked> '
        "turn</label></div>"
    )
    note = (
        "Drag to turn, scroll to zoom. The point under the mouse is marked on both shapes, "
        "through the sphere. The slider unrolls the shapes onto their spheres."
    )
    return (
        '<section><h2>Shapes that turn</h2><p class="note" id="viewer-note">'
        f'{note}</p>{controls}<div class="panes">{pane}{pane}</div>'
        f'<img id="texture" alt="" hidden src="{_texture(TEXTURE_SIZE)}"></section>'
    )


@lru_cache(maxsize=1)
def _texture(size: int) -> str:
    return _data_uri(Image.fromarray(cube_map(size)), "PNG")


def _left_out(page: Page) -> Iterator[str]:
    summary = page.summary or {}
    parts = (
        ("Skipped meshes", [(i["id"], i["reason"]) for i in summary.get("skipped") or []]),
        ("Shapes not learnt from", [(i["id"], i["reason"]) for i in summary.get("lost") or []]),
        ("Shapes without a map", [(i["id"], i["error"]) for i in summary.get("failed") or []]),
        ("Pictures not drawn", list(page.not_drawn.items())),
    )
    for heading, rows in parts:
        if rows:
            yield _section(heading, "", _table(["what", "why"], rows, text=True))


def _settings(settings: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in installed(PACKAGES).items())
    shown = escape(json.dumps(settings, indent=2, ensure_ascii=False, default=str))
    return (
        f'<p class="note">{escape(versions)}</p>'
        f"<details><summary>Settings</summary><pre>{shown}</pre></details>"
    )


def installed(packages: Sequence[str]) -> dict[str, str]:
    """Versions of those of the packages that are installed."""
    found = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _image(path: Path) -> str:
    with Image.open(path) as opened:
        picture = opened.convert("RGB")
    picture.thumbnail((PICTURE_WIDTH, 4 * PICTURE_WIDTH))
    return f'<img alt="{escape(path.stem)}" src="{_data_uri(picture, "WEBP")}">'


def _data_uri(picture: Image.Image, kind: str) -> str:
    stream = io.BytesIO()
    picture.save(stream, format=kind, quality=84, method=4)
    return f"data:image/{kind.lower()};base64,{base64.b64encode(stream.getvalue()).decode()}"


def _shape(label: str, map: SphericalMap, most_faces: int) -> dict[str, Any]:
    """A map for the browser: 16-bit positions, the surface within radius one."""
    if len(map.faces) > most_faces:
        # The finest icosphere that is allowed: the map itself gives the coarser shape.
        level = int(np.log(most_faces / 20) / np.log(4))
        ball = icosphere(level)
        remeshed = map.icosphere_remesh(level)
        surface, sphere, faces = remeshed.vertices, ball.vertices, ball.faces
    else:
        surface, sphere, faces = map.surface, map.sphere, map.faces
    centred = surface - (surface.max(axis=0) + surface.min(axis=0)) / 2
    largest = np.linalg.norm(centred, axis=1).max()
    wide = len(surface) > 65_535
    return {
        "label": label,
        "wide": wide,
        "surface": _base64(np.round(32_767 * centred / largest).astype("<i2")),
        "sphere": _base64(np.round(32_767 * sphere).astype("<i2")),
        "faces": _base64(faces.astype("<u4" if wide else "<u2")),
    }


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()
