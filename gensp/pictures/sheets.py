"""Sheets of shapes: the collection in one texture, each shape's map, morphs, flows, distortion."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.colors import Colormap
from PIL import Image

from gensp.errors import Unsupported
from gensp.geometry.distortion import isometric_distortion, singular_values
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_map import SphericalMap
from gensp.pictures.montage import Tile, colour_bar, grid, resized, rows_of
from gensp.pictures.render import Scene, View

Place = Callable[[np.ndarray], np.ndarray]

CLAY = np.array([0.78, 0.76, 0.74])
FOLDED = np.array([0.05, 0.15, 0.75])
SIGMA_RANGE = (1.0, 8.0)
SHEET_WIDTH = 4000
MANY = 10  # columns: sheets that have so many are shown smaller than they are
LARGE = 17  # lines of a caption to a tile of these
DISTORTION_COLOURS = "YlOrRd"


def distortion_colours(
    sigma: Float[np.ndarray, " m"], folded: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "m 3"]:
    """Colours of σ_t on a logarithmic scale from 1 to 8; folded faces blue."""
    low, high = np.log(SIGMA_RANGE)
    with np.errstate(divide="ignore"):
        place = (np.log(np.minimum(sigma, SIGMA_RANGE[1])) - low) / (high - low)
    colours = _distortion_map()(np.clip(place, 0, 1))[:, :3]
    colours[folded] = FOLDED
    return colours


def _distortion_map() -> Colormap:
    return matplotlib.colormaps[DISTORTION_COLOURS]


@dataclass(frozen=True)
class MapPictures:
    """One map, drawn four times at the same size.

    Attributes
    ----------
    textured, distorted
        The shape wearing the sphere's texture, and painted by σ_t.
    imprint
        The sphere coloured by the surface normals of the shape: where its features land.
    """

    textured: UInt8[np.ndarray, "size size 3"]
    distorted: UInt8[np.ndarray, "size size 3"]
    imprint: UInt8[np.ndarray, "size size 3"]


def draw_map(map: SphericalMap, view: View, size: int) -> MapPictures:
    """Draw the shape twice and its imprint on the sphere."""
    scene = Scene(map.mesh, view.fitted(map.surface), size, closed=True)
    sigma = isometric_distortion(singular_values(map.surface, map.sphere, map.faces))
    ball = Scene(map.mesh.with_vertices(map.sphere), view.fitted(icosphere(2).vertices), size)
    return MapPictures(
        textured=scene.textured(map.sphere),
        distorted=scene.by_face(distortion_colours(sigma, map.bad_faces())),
        imprint=ball.by_vertex(_normal_colours(map.mesh.vertex_normals @ view.rotation.T)),
    )


def _normal_colours(normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.clip(0.62 + 0.38 * normals, 0, 1)


def draw_maps(
    maps: Mapping[str, SphericalMap], view: View, size: int, jobs: int = 2
) -> dict[str, MapPictures]:
    """All maps; numpy leaves the interpreter for most of the work, so threads share it."""
    drawn = together(lambda map: draw_map(map, view, size), maps.values(), jobs)
    return dict(zip(maps, drawn, strict=True))


def together(draw: Callable[[Any], Any], items: Iterable[Any], jobs: int) -> list[Any]:
    """Results for all items, in order, drawn by several threads."""
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        return list(pool.map(draw, items))


def textured_sphere(view: View, size: int) -> UInt8[np.ndarray, "size size 3"]:
    """The texture where it is defined."""
    ball = icosphere(5)
    return Scene(ball, view.fitted(ball.vertices), size).textured(ball.vertices)


def columns_for(count: int) -> int:
    """Columns of a sheet that is a little wider than high, or higher where there are many."""
    wide, high = (round(np.sqrt(share * count)) for share in (1.5, 0.9))
    return max(1, min(count, wide, max(MANY, high)))


def contact_sheet(
    tiles: Sequence[Tile], sphere: UInt8[np.ndarray, "s s 3"], title: str
) -> Image.Image:
    """The teaser: the textured sphere, then every shape wearing the same texture."""
    first = Tile(sphere, "the sphere", " ")
    note = "one texture through every map; dots: blue training, amber validation, red test"
    return _sheet([first, *tiles], title, note)


def _sheet(tiles: Sequence[Tile], title: str, note: str) -> Image.Image:
    """All tiles in a sheet, made smaller where there are many of them."""
    columns = columns_for(len(tiles))
    side = min(len(tiles[0].image), SHEET_WIDTH // columns)
    smaller = [resized(tile, side) for tile in tiles]
    lines = LARGE if columns >= MANY else 26
    return grid(smaller, columns, title=title, note=note, lines=lines)


def distortion_sheet(tiles: Sequence[Tile], title: str) -> Image.Image:
    """All shapes painted by σ_t, with the scale."""
    sheet = _sheet(tiles, title, "folded faces are blue")
    low, high = np.log(SIGMA_RANGE)
    ticks = [(float((np.log(s) - low) / (high - low)), f"{s}") for s in (1, 2, 4)]
    return colour_bar(sheet, _distortion_map(), [*ticks, (1.0, f"≥ {SIGMA_RANGE[1]:.0f}")], "σ")


def map_strip(
    pictures: MapPictures, sphere: UInt8[np.ndarray, "s s 3"], name: str, note: str
) -> Image.Image:
    """One shape: sphere, shape in the sphere's texture, its imprint, its distortion."""
    tiles = [
        Tile(sphere, "sphere texture", " "),
        Tile(pictures.textured, name, note),
        Tile(pictures.imprint, "normals of the shape, on the sphere", " "),
        Tile(pictures.distorted, "isometric distortion σ", "1 pale … 8 dark red"),
    ]
    return grid(tiles, len(tiles))


def unmoved(p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """The generator's sphere is that of the maps."""
    return p


def morph_tiles(
    meshes: Sequence[Mesh], name: str, view: View, size: int, place: Place = unmoved
) -> list[Tile]:
    """g(t·z) for t from 0 to 1, at one scale: the sphere grows into the shape.

    `place` gives the place of the generator's points on the sphere of the maps.
    """
    p = place(icosphere(icosphere_level(meshes[0].faces)).vertices)
    view = view.fitted(*(mesh.vertices for mesh in meshes))
    last = max(1, len(meshes) - 1)
    return [
        Tile(
            Scene(mesh, view, size).textured(p), f"t = {k / last:.2f}", name if k == last else " "
        )
        for k, mesh in enumerate(meshes)
    ]


@dataclass(frozen=True)
class Way:
    """Surfaces on a way along a tree, and of each the node that comes next."""

    meshes: Sequence[Mesh]
    nodes: Sequence[str]


def way_tiles(way: Way, name: str, view: View, size: int, place: Place = unmoved) -> list[Tile]:
    """As `morph_tiles`, with the nodes below."""
    tiles = morph_tiles(way.meshes, name, view, size, place)
    return [
        replace(tile, caption=node, note=tile.caption)
        for tile, node in zip(tiles, way.nodes, strict=True)
    ]


def icosphere_level(faces: Int[np.ndarray, "m 3"]) -> int:
    """Subdivision level of the icosphere that has these faces.

    Raises
    ------
    Unsupported
        The triangulation is not that of an icosphere.
    """
    level = round(np.log(len(faces) / 20) / np.log(4))
    if level < 0 or not np.array_equal(icosphere(level).faces, faces):
        raise Unsupported(
            f"a morph strip: {len(faces)} faces; the triangulation of an icosphere (20·4^level) "
            "is required; decode the generator at icosphere vertices"
        )
    return level


def flow_tiles(
    vertices: Float[np.ndarray, "t n 3"],
    faces: Int[np.ndarray, "m 3"],
    name: str,
    view: View,
    size: int,
    frames: int,
) -> list[Tile]:
    """A mean curvature flow, equally spaced in arc length, in the texture of where it ends."""
    steps = np.sqrt(((vertices[1:] - vertices[:-1]) ** 2).sum(axis=2).mean(axis=1))
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = np.abs(arc[None] - np.linspace(0, arc[-1], frames)[:, None]).argmin(axis=1)
    end = unit(vertices[-1] - vertices[-1].mean(axis=0))
    view = view.fitted(*vertices[chosen])
    return [
        Tile(
            Scene(Mesh(vertices[k], faces), view, size).textured(end),
            f"step {k}",
            name if place == 0 else " ",
        )
        for place, k in enumerate(chosen)
    ]


def prediction_tiles(
    map: SphericalMap,
    generated: Float[np.ndarray, "k 3"],
    view: View,
    size: int,
    place: Place = unmoved,
) -> list[Tile]:
    """The input, the surface that the generator makes of it, and the input in its final map.

    `place` as in `morph_tiles`.
    """
    count = len(generated)
    ball = icosphere(round(np.log((count - 2) / 10) / np.log(4)))
    shape = Scene(map.mesh, view.fitted(map.surface), size, closed=True)
    made = Scene(Mesh(generated, ball.faces), view.fitted(generated), size)
    clay = np.broadcast_to(CLAY, map.surface.shape)
    return [
        Tile(shape.by_vertex(clay), map.name, "input"),
        Tile(made.textured(place(ball.vertices)), "generated surface", " "),
        Tile(shape.textured(map.sphere), "final map", " "),
    ]


def strips(rows: Sequence[Sequence[Tile]], title: str, note: str) -> Image.Image:
    """Strips below each other."""
    return rows_of(rows, title=title, note=note)
