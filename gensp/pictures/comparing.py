"""Maps of several shapes, and of several methods, beside each other: colours, error, texture."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LinearSegmentedColormap
from PIL import Image
from scipy.spatial import cKDTree

from gensp.geometry.implied import correspondence_error
from gensp.geometry.points import SurfacePoints
from gensp.geometry.spherical_map import SphericalMap, load_map
from gensp.layout import item_file
from gensp.pictures.material import Material, NotDrawn, Truth
from gensp.pictures.montage import Tile, colour_bar, rows_of, save_png
from gensp.pictures.render import Scene, View
from gensp.pictures.sheets import textured_sphere, together

WORST = 0.15  # of √area: errors from here on are painted alike
DOT = 0.03  # radius of a keypoint, of √area
PLAIN, WRONG = (0.93, 0.93, 0.9), (0.75, 0.05, 0.05)
RIM = 0.2
UNKNOWN = 0.8 * np.array(PLAIN)
ERROR_COLOURS = LinearSegmentedColormap.from_list("error", [PLAIN, WRONG])

Maps = Mapping[str, SphericalMap]


def position_colours(map: SphericalMap) -> Float[np.ndarray, "n 3"]:
    """Colours of a shape's vertices by where they are."""
    low, high = map.surface.min(axis=0), map.surface.max(axis=0)
    colours: np.ndarray = 0.15 + 0.8 * (map.surface - low) / (high - low)
    return colours


def error_colours(error: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    """From nearly white to red at `WORST`."""
    colours: np.ndarray = ERROR_COLOURS(np.minimum(error / WORST, 1))[:, :3]
    return colours


class Matched:
    """Colours of one shape carried to others through the sphere, and how wrong that is.

    Parameters
    ----------
    truth
        Where two shapes have the same points.
    """

    def __init__(self, truth: Truth, view: View, size: int) -> None:
        self.truth, self.view, self.size = truth, view, size

    def rows(self, maps: Maps, label: str, jobs: int = 1) -> list[list[Tile]]:
        """Two rows: the first shape and the others in its colours; the error below each."""
        source, *others = maps.values()
        colours = position_colours(source)
        first = Tile(self._scene(source).by_vertex(colours), source.name, label)
        blank = Tile(np.full((self.size, self.size, 3), 255, dtype=np.uint8), "", "error")
        pairs = together(lambda map: self._pair(source, map, colours, label), others, jobs)
        return [[first, *(above for above, _ in pairs)], [blank, *(below for _, below in pairs)]]

    def _pair(
        self, source: SphericalMap, map: SphericalMap, colours: np.ndarray, label: str
    ) -> tuple[Tile, Tile]:
        scene, at = self._scene(map), source.locate(map.sphere)
        above = scene.by_vertex(at.on(colours, source.faces))
        painted, said = self._painted(scene, source, map)
        return Tile(above, map.name, label), Tile(painted, map.name, said)

    def _painted(
        self, scene: Scene, source: SphericalMap, map: SphericalMap
    ) -> tuple[np.ndarray, str]:
        """The error on the shape, and its mean in words."""
        known = self.truth(source.name, map.name)
        if known is None:
            return scene.by_vertex(np.tile(UNKNOWN, (len(map.surface), 1))), "no ground truth"
        at_source, at, dense = known
        error = correspondence_error(source, map, at_source, at)
        mean = f"{error.mean():.3f}"
        if dense:
            return scene.by_vertex(_spread(map, at, error)), f"mean error {mean}"
        return scene.by_point(_dots(map, at, error)), f"at {len(error)} keypoints {mean}"

    def _scene(self, map: SphericalMap) -> Scene:
        return Scene(map.mesh, self.view.fitted(map.surface), self.size, closed=True)


def _spread(
    map: SphericalMap, at: SurfacePoints, error: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n 3"]:
    """Colours of vertices by the error of the nearest point."""
    nearest = cKDTree(at.on(map.surface, map.faces)).query(map.surface)[1]
    return error_colours(error[nearest])


def _dots(
    map: SphericalMap, at: SurfacePoints, error: Float[np.ndarray, " k"]
) -> Callable[[np.ndarray], np.ndarray]:
    """Colours of points of a surface: those near a keypoint by its error, in a dark rim."""
    tree, shown = cKDTree(at.on(map.surface, map.faces)), error_colours(error)
    radius = DOT * np.sqrt(map.mesh.area)

    def colours(points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 3"]:
        gap, nearest = tree.query(points)
        painted = np.tile(UNKNOWN, (len(points), 1))
        painted[gap < radius] = RIM
        inside = gap < 0.75 * radius
        painted[inside] = shown[nearest[inside]]
        return painted

    return colours


def with_scale(picture: Image.Image) -> Image.Image:
    """The picture with the scale of the errors below."""
    ticks = [(place, f"{place * WORST:.2f}") for place in (0, 1 / 3, 2 / 3)]
    return colour_bar(picture, ERROR_COLOURS, [*ticks, (1.0, f"≥ {WORST}")], "error / √area")


def textured_rows(
    methods: Mapping[str, Maps], view: View, size: int, jobs: int = 1
) -> list[list[Tile]]:
    """A row for every method: the sphere, and the shapes in its texture."""
    sphere = textured_sphere(view, size)

    def drawn(map: SphericalMap) -> np.ndarray:
        scene = Scene(map.mesh, view.fitted(map.surface), size, closed=True)
        return scene.textured(map.sphere)

    return [
        [
            Tile(sphere, label, "the sphere"),
            *(
                Tile(image, name, label)
                for name, image in zip(maps, together(drawn, maps.values(), jobs), strict=True)
            ),
        ]
        for label, maps in methods.items()
    ]


def matching(material: Material) -> list[Path]:
    """Colours of one shape on a few others, with the error."""
    if material.truth is None:
        raise NotDrawn("no ground truth is known of these shapes")
    names = _few(material)
    if len(names) < 2:
        raise NotDrawn("there is one map alone")
    view, size, jobs = material.view, material.strip_tile, material.options.jobs
    matched = Matched(material.truth, view, size)
    rows = matched.rows({name: material.maps[name] for name in names}, material.title, jobs)
    picture = with_scale(rows_of(rows, title="Matching", note=material.title))
    return [save_png(picture, material.pictures / "matching.png")]


def side_by_side(material: Material) -> list[Path]:
    """A few shapes in one texture, through these maps and those of other methods."""
    names = _few(material)
    files = {
        label: [item_file(folder, "maps", name) for name in names]
        for label, folder in material.others.items()
    }
    found = {
        label: {path.stem: load_map(path) for path in paths}
        for label, paths in files.items()
        if all(path.is_file() for path in paths)
    }
    if not found:
        raise NotDrawn("no method that learns nothing is evaluated yet in this experiment")
    methods = {material.title: {name: material.maps[name] for name in names}, **found}
    rows = textured_rows(methods, material.view, material.strip_tile, material.options.jobs)
    picture = rows_of(rows, title="Side by side", note="one texture through every map")
    return [save_png(picture, material.pictures / "side_by_side.png")]


def _few(material: Material) -> list[str]:
    splits = {name: material.splits[name] for name in material.maps}
    return material.options.chosen(splits, material.options.matches + 1)
