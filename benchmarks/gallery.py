"""Maps of several methods side by side: one texture, and colours carried by correspondence.

    python benchmarks/gallery.py data/heads --out docs/gallery/heads \
        GenSP=heads --best docs/benchmark/heads.csv
    python benchmarks/gallery.py data/quadrupeds --out docs/gallery/quadrupeds --no-sheet \
        prediction=RUN/full+certify registered=RUN/full+guided+certify \
        --match held_out donkey_rest donkey_walk donkey_death / shiba_rest shiba_walk

Each NAME=SOURCE is a method. SOURCE is a variant's folder with a finished stage parameterize; or a
method that maps one shape alone, such as `stretch`; or a model of the package, such as `heads`,
whose maps from the prediction alone are `heads/prediction`. `--best` adds the methods that learn
nothing, fold nothing and have the least error without rotation: of an experiment's folder, whose
maps are taken, or of a table.csv such as those in docs/benchmark, whose maps are made.

Written are `<out>_side_by_side.jpg` (all shapes in one texture, a row for every method), and for
every `--match NAME` `<out>_NAME.jpg`: colours of a shape carried to those named after it, and the
error where there is ground truth, keypoints as dots; the best rotation is not used. After a slash
another shape begins.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from PIL import Image

import gensp
from gensp.benchmark import best_baselines
from gensp.comparison import baselines
from gensp.data.shapes import ShapeCollection
from gensp.errors import MissingData
from gensp.files import atomic_path, read_rows
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.methods.table import PER_SHAPE, per_shape
from gensp.pictures.comparing import Maps, Matched, textured_rows, with_scale
from gensp.pictures.material import evenly
from gensp.pictures.montage import Tile, rows_of
from gensp.pictures.render import look
from gensp.pretrained import shipped
from gensp.tasks.evaluate import map_path

SHEET_COLUMNS, SHEET_TILE = 11, 218  # the sphere first
WIDTH = 2400
Source = Callable[[Mesh], SphericalMap]


def source(word: str) -> Source:
    """Where the maps of a method come from: a folder, a method by name, or a model."""
    name, _, part = word.partition("/")
    if word in PER_SHAPE:
        return per_shape(word)
    if name in shipped() and part in ("", "prediction"):
        return gensp.load(name, register=False if part else None)
    folder = Path(word) / "parameterize"
    if not (folder / "manifest.json").is_file():
        raise MissingData(
            f"{word}: has no finished stage parameterize; a variant's folder is required, or one "
            f"of {', '.join([*PER_SHAPE, *shipped()])}; correct it"
        )
    return lambda mesh: load_map(map_path(folder, mesh.name))


def best(place: Path, count: int) -> dict[str, str]:
    """The best methods that learn nothing: name → source."""
    if place.is_dir():
        found = baselines(place, besides=place, count=count)
        return {name: str(folder.parent) for name, folder in found.items()}
    rows = [row for row in read_rows(place) if row["split"] == "all"]
    return {
        str(row["variant"]): str(row["method"]) for row in best_baselines(map(_told, rows), count)
    }


def _told(row: Mapping[str, str]) -> dict[str, Any]:
    """A row of a table as a summary."""
    figures = {key: float(row[key]) for key in ("error", "affected_shapes") if row[key]}
    failed = int(row["failures"] or 0)
    return {**row, "failed": failed, "groups": {"all": figures}}


def made(
    sources: Mapping[str, Source], collection: ShapeCollection, ids: Iterable[str]
) -> dict[str, dict[str, SphericalMap]]:
    """The maps of some shapes, method by method."""
    meshes = {id: collection.mesh(id) for id in dict.fromkeys(ids)}
    return {
        name: {id: replace(method(mesh), name=id) for id, mesh in meshes.items()}
        for name, method in sources.items()
    }


def sheet(
    methods: Mapping[str, Maps], collection: ShapeCollection, ids: Sequence[str]
) -> Image.Image:
    """The shapes in bands, a row of every band for every method."""
    view, width, rows = look(collection.up), SHEET_COLUMNS - 1, []
    for k in range(0, len(ids), width):
        band = ids[k : k + width]
        maps = {name: {id: of[id] for id in band} for name, of in methods.items()}
        rows += textured_rows(maps, view, SHEET_TILE)
    marked = [[_marked(tile, collection) for tile in row] for row in rows]
    return rows_of(marked, title=f"{collection.name}: one texture through every map")


def _marked(tile: Tile, collection: ShapeCollection) -> Tile:
    known = tile.caption in collection.ids()
    return replace(tile, split=collection.shape(tile.caption).split) if known else tile


def matching(
    methods: Mapping[str, Maps],
    collection: ShapeCollection,
    groups: Sequence[Sequence[str]],
    size: int,
) -> Image.Image:
    """Two rows for every method: each group's first shape and the others, and their error."""
    matched, rows = Matched(collection.points_in_common, look(collection.up), size), []
    for name, maps in methods.items():
        found = [matched.rows({id: maps[id] for id in group}, name) for group in groups]
        rows += [[tile for pair in found for tile in pair[k]] for k in (0, 1)]
    title = f"{collection.name}: colours of one shape on the others"
    return with_scale(rows_of(rows, title=title))


def groups_of(words: Sequence[str]) -> list[list[str]]:
    """Words between slashes."""
    return [list(group) for slash, group in groupby(words, "/".__eq__) if not slash]


def save(picture: Image.Image, path: Path) -> None:
    """As JPEG, no wider than a page needs."""
    picture.thumbnail((WIDTH, 10 * WIDTH))
    with atomic_path(path) as temporary:
        picture.save(temporary, format="JPEG", quality=80)
    sys.stdout.write(f"{path}\n")


def arguments() -> argparse.Namespace:
    """What was typed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("collection", type=Path)
    parser.add_argument("methods", nargs="*", metavar="NAME=SOURCE")
    parser.add_argument("--best", type=Path, help="experiment's folder, or table.csv")
    parser.add_argument("--count", type=int, default=2, help="how many of the best")
    parser.add_argument("--match", nargs="+", action="append", metavar="NAME SHAPE", default=[])
    parser.add_argument("--no-sheet", action="store_true", help="no side_by_side")
    parser.add_argument("--shapes", type=int, help="so many in side_by_side (default: all)")
    parser.add_argument("--size", type=int, default=360)
    parser.add_argument("--out", type=Path, required=True)
    return parser.parse_intermixed_args()


def main() -> None:
    """Draw the pictures."""
    chosen = arguments()
    collection = ShapeCollection.from_folder(chosen.collection)
    words = dict(word.split("=", 1) for word in chosen.methods)
    words |= best(chosen.best, chosen.count) if chosen.best else {}
    sources = {name: source(word) for name, word in words.items()}
    ids = [] if chosen.no_sheet else evenly(collection.ids(), chosen.shapes or len(collection))
    figures = {name: groups_of(shapes) for name, *shapes in chosen.match}
    matched = [id for groups in figures.values() for group in groups for id in group]
    maps = made(sources, collection, [*ids, *matched])
    if ids:
        save(sheet(maps, collection, ids), _beside(chosen.out, "side_by_side"))
    for name, groups in figures.items():
        save(matching(maps, collection, groups, chosen.size), _beside(chosen.out, name))


def _beside(out: Path, name: str) -> Path:
    return out.with_name(f"{out.name}_{name}.jpg")


if __name__ == "__main__":
    main()
