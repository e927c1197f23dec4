"""What an evaluation has to draw from: maps, folders of the stages, figures; and how much."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gensp.errors import GenSPError
from gensp.files import read_rows
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.spherical_map import SphericalMap
from gensp.layout import item_file
from gensp.pictures import sheets
from gensp.pictures.montage import Tile
from gensp.pictures.render import View, look

# Names of two shapes → the same points on both, and whether they are dense; None: none are known.
Truth = Callable[[str, str], tuple[SurfacePoints, SurfacePoints, bool] | None]


class NotDrawn(GenSPError):
    """A picture whose material is not there; the message is the reason."""


@dataclass(frozen=True)
class PictureOptions:
    """How much is drawn.

    Attributes
    ----------
    tile
        Side in pixels of one picture of a shape.
    frames
        Pictures of a morph or flow strip.
    strips
        Shapes that are drawn as morphs, flows and predictions.
    tree_strips
        Shapes that are drawn as morphs along the tree.
    matches
        Shapes that colours of one more are carried to, and that are drawn through other maps.
    turning, turning_faces
        Shapes that turn in the page, and how many faces each may have.
    gallery
        Shapes shown one by one in the page; the folder has all of them.
    up, azimuth, elevation
        The view: up axis (x, y, z, or with a minus sign) and degrees.
    jobs
        Threads that draw.
    """

    tile: int = 360
    frames: int = 7
    strips: int = 3
    tree_strips: int = 3
    matches: int = 5
    turning: int = 12
    turning_faces: int = 20_000
    gallery: int = 40
    up: str = "y"
    azimuth: float = 35.0
    elevation: float = 15.0
    jobs: int = 2

    def chosen(self, splits: Mapping[str, str], count: int | None = None) -> list[str]:
        """A few shapes that stand for all: unseen ones first, evenly through the collection."""
        rank = {"test": 0, "val": 1, "train": 2}
        ordered = sorted(splits, key=lambda name: rank.get(splits[name], 3))
        first = [name for name in ordered if splits[name] == splits[ordered[0]]]
        wanted = self.strips if count is None else count
        pool = first if len(first) >= wanted else ordered
        return evenly(pool, wanted)


def evenly(names: Sequence[str], count: int) -> list[str]:
    """So many of them, evenly through all."""
    places = np.linspace(0, len(names) - 1, min(count, len(names))).round().astype(int)
    return [names[place] for place in places]


@dataclass(frozen=True)
class Generated:
    """Surfaces that a generator made for the pictures, on an icosphere's triangles.

    Attributes
    ----------
    morphs
        For a few shapes g(t·z).
    ways
        For a few shapes the surfaces along the tree.
    place
        Where maps have the generator's points of the sphere (`gensp.models.atlas.Atlas.place`).
    """

    morphs: Mapping[str, Sequence[Mesh]] = field(default_factory=dict)
    ways: Mapping[str, sheets.Way] = field(default_factory=dict)
    place: sheets.Place = sheets.unmoved


@dataclass(frozen=True)
class Material:
    """What the stages left to be drawn."""

    folder: Path
    runs: Mapping[str, Path]
    splits: Mapping[str, str]
    title: str
    summary: Mapping[str, Any] | None
    options: PictureOptions
    maps: Mapping[str, SphericalMap] = field(default_factory=dict)
    generated: Generated = Generated()
    truth: Truth | None = None
    others: Mapping[str, Path] = field(default_factory=dict)

    @property
    def pictures(self) -> Path:
        """Where the pictures go."""
        return self.folder / "pictures"

    @property
    def strip_tile(self) -> int:
        """Side in pixels of one picture of a strip."""
        return max(120, round(self.options.tile * 0.6))

    @cached_property
    def view(self) -> View:
        """The direction from which all shapes are seen."""
        return look(self.options.up, self.options.azimuth, self.options.elevation)

    @cached_property
    def drawn_maps(self) -> dict[str, sheets.MapPictures]:
        """Every map, drawn once for all sheets."""
        return sheets.draw_maps(self.maps, self.view, self.options.tile, self.options.jobs)

    @cached_property
    def sphere(self) -> np.ndarray:
        """The textured sphere."""
        return sheets.textured_sphere(self.view, self.options.tile)

    @cached_property
    def notes(self) -> dict[str, str]:
        """A line of figures for every shape, from shapes.csv."""
        return {row["id"]: _note(row) for row in self.figures}

    @cached_property
    def figures(self) -> list[dict[str, str]]:
        """The rows of shapes.csv, if it is there."""
        table = self.folder / "shapes.csv"
        return read_rows(table) if table.is_file() else []

    def worst(self, figure: str, count: int) -> list[str]:
        """Shapes with a map whose figure is largest, the largest first."""
        known = [row for row in self.figures if row.get(figure) and row["id"] in self.maps]
        known.sort(key=lambda row: -float(row[figure]))
        return [row["id"] for row in known[:count]]

    def tile(self, name: str, image: np.ndarray) -> Tile:
        """A picture of a shape with its name, figures and split."""
        return Tile(image, name, self.notes.get(name, " "), self.splits.get(name, ""))

    def artefact(self, stage: str, name: str) -> Path:
        """A file or folder of another stage.

        Raises
        ------
        NotDrawn
            The stage was not part of this run, or left no such file.
        """
        if stage not in self.runs:
            raise NotDrawn(f"this run has no stage {stage}")
        path = self.runs[stage] / name
        if not path.exists():
            raise NotDrawn(f"stage {stage} left no {name}")
        return path

    def files(self, stage: str, kind: str) -> dict[str, Path]:
        """Where another stage keeps the npz of every shape, whether it has one or not.

        Raises
        ------
        NotDrawn
            As of `artefact`, for the folder of all of them.
        """
        folder = self.artefact(stage, kind).parent
        return {name: item_file(folder, kind, name) for name in self.splits}


def _note(row: Mapping[str, str]) -> str:
    words = [
        f"{word} {float(row[key]):{form}}"
        for key, word, form in (("sigma_mean", "σ", ".2f"), ("sigma_max", "max", ".4g"))
        if row.get(key)
    ]
    if row.get("bad_faces") and float(row["bad_faces"]) > 0:
        words.append(f"{float(row['bad_faces']):.0f} bad faces")
    return " · ".join(words) or " "
