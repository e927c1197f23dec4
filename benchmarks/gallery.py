"""Finished runs side by side: one texture, and colours carried by correspondence.

    python benchmarks/gallery.py data/quadrupeds --out docs/gallery/quadrupeds \
        GenSP=RUN/full+guided+certify dirichlet=RUN/dirichlet stretch=RUN/stretch

Each NAME=FOLDER is a variant's folder with a finished stage parameterize. Written are
`<out>_side_by_side.jpg` (rows: methods; columns: shapes in one texture of the sphere) and
`<out>_matching.jpg` (colours of the first shape carried to the others by each method, and the
error painted where there is ground truth; the best rotation is not used).
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from gensp.data.ground_truth import common_points
from gensp.data.shapes import ShapeCollection
from gensp.files import atomic_path
from gensp.geometry.implied import correspondence_error
from gensp.geometry.mesh import normalize
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.pictures.montage import Tile, rows_of
from gensp.pictures.render import Scene, look
from gensp.pictures.sheets import textured_sphere
from gensp.tasks.evaluate import map_path

WORST = 0.15  # of √area: errors from here on are painted alike
PLAIN, WRONG = np.array([0.93, 0.93, 0.9]), np.array([0.75, 0.05, 0.05])

Methods = Mapping[str, Mapping[str, SphericalMap]]


def read(methods: Sequence[str], ids: Sequence[str]) -> Methods:
    """The maps of the shapes, method by method."""
    found = {}
    for word in methods:
        name, folder = word.split("=", 1)
        maps = Path(folder) / "parameterize"
        found[name] = {id: load_map(map_path(maps, id)) for id in ids}
    return found


def side_by_side(methods: Methods, collection: ShapeCollection, size: int) -> Image.Image:
    """One row per method, the sphere in front."""
    view = look(collection.up)
    sphere = Tile(textured_sphere(view, size), "the sphere", " ")
    rows = []
    for name, maps in methods.items():
        tiles = [
            Tile(
                Scene(map.mesh, view.fitted(map.surface), size, closed=True).textured(map.sphere),
                id,
                name,
                collection.shape(id).split,
            )
            for id, map in maps.items()
        ]
        rows.append([sphere, *tiles])
    return rows_of(rows, title=f"{collection.name}: one texture through every map")


def matching(methods: Methods, collection: ShapeCollection, size: int) -> Image.Image:
    """Colours of the first shape on all others, and below them the error."""
    view, rows = look(collection.up), []
    for name, maps in methods.items():
        source, *others = maps
        colours = position_colours(maps[source])
        first = Scene(maps[source].mesh, view.fitted(maps[source].surface), size, closed=True)
        above = [Tile(first.by_vertex(colours), source, name)]
        below = [Tile(np.full((size, size, 3), 255, dtype=np.uint8), "", "error")]
        for id in others:
            map = maps[id]
            scene = Scene(map.mesh, view.fitted(map.surface), size, closed=True)
            at = maps[source].locate(map.sphere)
            above.append(Tile(scene.by_vertex(at.on(colours, maps[source].faces)), id, name))
            painted, mean = error_colours(collection, maps[source], map)
            said = "no ground truth" if mean is None else f"mean error {mean:.3f}"
            below.append(Tile(scene.by_vertex(painted), id, said))
        rows += [above, below]
    return rows_of(rows, title=f"{collection.name}: colours of the first shape on the others")


def position_colours(map: SphericalMap) -> np.ndarray:
    """Colours of a shape's vertices by where they are."""
    low, high = map.surface.min(axis=0), map.surface.max(axis=0)
    colours: np.ndarray = 0.15 + 0.8 * (map.surface - low) / (high - low)
    return colours


def error_colours(
    collection: ShapeCollection, a: SphericalMap, b: SphericalMap
) -> tuple[np.ndarray, float | None]:
    """Vertices of b painted by the error of the nearest point with ground truth, and its mean."""
    truths = [collection.ground_truth(map.name) for map in (a, b)]
    grey = np.tile(0.8 * PLAIN, (len(b.surface), 1))
    if truths[0] is None or truths[1] is None:
        return grey, None
    rows, others = common_points(truths[0], truths[1])
    if len(rows) == 0:
        return grey, None
    at_a, at_b = truths[0].take(rows).at, truths[1].take(others).at
    error = correspondence_error(a, b, at_a, at_b)
    nearest = cKDTree(at_b.on(b.surface, b.faces)).query(b.surface)[1]
    share = np.minimum(error[nearest] / WORST, 1)[:, None]
    return (1 - share) * PLAIN + share * WRONG, float(error.mean())


def save(picture: Image.Image, path: Path, width: int = 2400) -> None:
    """As JPEG, no wider than that."""
    if picture.width > width:
        height = round(picture.height * width / picture.width)
        picture = picture.resize((width, height), Image.Resampling.LANCZOS)
    with atomic_path(path) as temporary:
        picture.save(temporary, format="JPEG", quality=85)
    sys.stdout.write(f"{path}\n")


def main() -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("collection", type=Path)
    parser.add_argument("methods", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--ids", nargs="*", help="shapes (default: eight, spread over all)")
    parser.add_argument("--size", type=int, default=360)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    collection = ShapeCollection.from_folder(chosen.collection)
    every = collection.ids()
    ids = chosen.ids or [every[k] for k in np.linspace(0, len(every) - 1, 8).astype(int)]
    methods = read(chosen.methods, ids)
    normalised = {
        name: {id: _scaled(map) for id, map in maps.items()} for name, maps in methods.items()
    }
    pictures = {
        "side_by_side": side_by_side(normalised, collection, chosen.size),
        "matching": matching(normalised, collection, chosen.size),
    }
    for name, picture in pictures.items():
        save(picture, chosen.out.with_name(f"{chosen.out.name}_{name}.jpg"))


def _scaled(map: SphericalMap) -> SphericalMap:
    return SphericalMap(map.sphere, normalize(map.mesh).vertices, map.faces, map.name)


if __name__ == "__main__":
    main()
