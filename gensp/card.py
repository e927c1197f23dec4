"""The data card of a collection: what is in it, on one page with one picture."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np

from gensp.data.folder import SPLITS, Shape, list_meshes, read_manifest
from gensp.data.ground_truth import load_ground_truth
from gensp.data.keypoints import load_keypoint_records
from gensp.errors import MissingData
from gensp.files import atomic_path, read_rows, write_text
from gensp.geometry.mesh import Mesh, load_mesh
from gensp.tables import markdown_table

CARD, PICTURE = "CARD.md", "card.jpg"
_COLUMNS, _TILE = 6, 160
_REASONS = 12  # of the reasons for dropping meshes so many are listed


@dataclass(frozen=True)
class Size:
    """Measures of one mesh: counts, genus, area and box diagonal in its file's units.

    The genus is None where the surface is not closed.
    """

    vertices: int
    faces: int
    genus: int | None
    area: float
    diagonal: float


def write_card(
    folder: Path,
    *,
    name: str | None = None,
    up: str = "y",
    out: Path | None = None,
    shown: int = 24,
) -> list[Path]:
    """Write CARD.md and card.jpg of a collection's folder.

    Parameters
    ----------
    up
        Axis that points up in the picture: x, y or z.
    out
        Where to write; the folder itself without it.
    shown
        So many meshes are drawn, evenly along the collection.

    Raises
    ------
    MissingData
        The folder is none or holds no mesh.
    BadMesh
        One of its meshes cannot be read.
    """
    if not folder.is_dir():
        raise MissingData(
            f"{folder}: is not a folder; a collection is required; name the folder of its meshes"
        )
    name = name or folder.resolve().name
    known = (folder / "manifest.csv").is_file()
    shapes = read_manifest(folder) if known else list_meshes(folder, name)
    sizes = {shape.id: _measured(load_mesh(shape.path)) for shape in shapes}
    place = out or folder
    picture = _draw(shapes, sizes, up, shown, place / PICTURE)
    write_text(place / CARD, _page(folder, name, shapes, sizes))
    return [place / CARD, picture]


def _measured(mesh: Mesh) -> Size:
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return Size(len(mesh.vertices), len(mesh.faces), _genus(mesh), mesh.area, diagonal)


def _genus(mesh: Mesh) -> int | None:
    """Handles of a closed surface, over all its parts."""
    if 2 * len(mesh.edges) != 3 * len(mesh.faces):
        return None
    return int(igl.facet_components(mesh.faces)[0]) - mesh.euler // 2


def _page(folder: Path, name: str, shapes: Sequence[Shape], sizes: Mapping[str, Size]) -> str:
    facts = [*_facts(shapes, list(sizes.values())), *_truths(folder, shapes)]
    parts = [
        f"# Data card: {name}\n\nWritten by `gensp card`; units are those of the files.",
        f"![Meshes of {name}]({PICTURE})",
        _table(("", ""), facts),
        *_section("Categories", ("category", *SPLITS), _categories(shapes)),
        *_section("Licences", ("licence", "source", "meshes"), _licences(shapes)),
        *_section("Preparation", ("verdict", "meshes"), _verdicts(folder)),
        *_section("Surfaces that pass through themselves, as found", _CROSSING, _crossing(folder)),
        *_section("Left out", ("meshes", "reason"), _reasons(folder)),
    ]
    return "\n\n".join(parts) + "\n"


def _facts(shapes: Sequence[Shape], sizes: Sequence[Size]) -> list[tuple[str, str]]:
    splits = Counter(shape.split for shape in shapes)
    told = ", ".join(f"{split} {splits[split]}" for split in SPLITS if splits[split])
    genus = Counter("not closed" if size.genus is None else str(size.genus) for size in sizes)
    formats = Counter(shape.path.suffix[1:].lower() for shape in shapes)
    return [
        ("meshes", f"{len(shapes)} ({told})"),
        ("vertices", _range([size.vertices for size in sizes])),
        ("faces", _range([size.faces for size in sizes])),
        ("genus", ", ".join(f"{key}: {count} meshes" for key, count in sorted(genus.items()))),
        ("area", _range([size.area for size in sizes])),
        ("box diagonal", _range([size.diagonal for size in sizes])),
        ("files", ", ".join(f"{count} {suffix}" for suffix, count in formats.most_common())),
    ]


def _range(values: Sequence[float]) -> str:
    low, high, middle = map(_number, (min(values), max(values), float(np.median(values))))
    return f"{low} to {high}, median {middle}"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:.4g}"


def _truths(folder: Path, shapes: Sequence[Shape]) -> list[tuple[str, str]]:
    dense = [shape for shape in shapes if shape.correspondence is not None]
    templates = {shape.template for shape in dense}
    points = [len(load_ground_truth(s.correspondence, "").ids) for s in dense if s.correspondence]
    told = (
        f"{len(dense)} meshes of {len(templates)} templates, {_range(points)} points"
        if dense
        else "none"
    )
    rows = [("dense ground truth", told)]
    path = folder / "keypoints.json"
    if path.is_file():
        records = load_keypoint_records(path)
        names = {
            point["semantic_id"] for record in records.values() for point in record["keypoints"]
        }
        rows.append(("keypoints", f"{len(records)} meshes, {len(names)} semantic ids"))
    return rows


def _categories(shapes: Sequence[Shape]) -> list[tuple[str, ...]]:
    counts = Counter((dict(shape.columns).get("category", ""), shape.split) for shape in shapes)
    names = sorted({category for category, _ in counts})
    if names == [""]:
        return []
    return [(name, *(str(counts[name, split]) for split in SPLITS)) for name in names]


def _licences(shapes: Sequence[Shape]) -> list[tuple[str, ...]]:
    known = (dict(shape.columns) for shape in shapes)
    counts = Counter(
        (row.get("licence", "not told"), _origin(row.get("source", ""))) for row in known
    )
    return [(licence, source, str(count)) for (licence, source), count in counts.most_common()]


def _origin(source: str) -> str:
    """The part of a source that many meshes share."""
    return source.split("/", 1)[0] if source.startswith("ShapeNetCore") else source


def _verdicts(folder: Path) -> list[tuple[str, ...]]:
    counts = Counter(row.get("verdict", "") for row in _rows(folder / "prepared.csv"))
    return [(verdict, str(count)) for verdict, count in counts.most_common()]


_CROSSING = ("verdict", "meshes", "of", "faces of one")


def _crossing(folder: Path) -> list[tuple[str, ...]]:
    """How many meshes of each verdict had self-intersections, and in how many faces."""
    key = "self_intersecting_before"
    rows = [row for row in _rows(folder / "prepared.csv") if row.get(key)]
    found: dict[str, list[int]] = {}
    for row in rows:
        found.setdefault(row.get("verdict", ""), []).append(int(float(row[key])))
    crossing = {verdict: [n for n in counts if n] for verdict, counts in found.items()}
    return [
        (verdict, str(len(some)), str(len(found[verdict])), _range(some))
        for verdict, some in crossing.items()
        if some
    ]


def _reasons(folder: Path) -> list[tuple[str, ...]]:
    counts = Counter(row["reason"] for row in _rows(folder / "dropped.csv"))
    return [(str(count), reason) for reason, count in counts.most_common(_REASONS)]


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    return read_rows(path)


def _section(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"## {title}", _table(header, rows)] if rows else []


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return markdown_table(header, [[_cell(text) for text in row] for row in rows]).rstrip()


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _draw(
    shapes: Sequence[Shape], sizes: Mapping[str, Size], up: str, shown: int, path: Path
) -> Path:
    # Imported late: matplotlib takes a second, and only the picture needs it.
    from gensp.pictures.montage import Tile, grid
    from gensp.pictures.render import Scene, look
    from gensp.pictures.sheets import CLAY

    places = np.unique(np.linspace(0, len(shapes) - 1, min(shown, len(shapes))).astype(int))
    tiles = []
    for shape in (shapes[place] for place in places):
        mesh = load_mesh(shape.path)
        view = look(up).fitted(mesh.vertices)
        image = Scene(mesh, view, _TILE).by_face(np.tile(CLAY, (len(mesh.faces), 1)))
        note = f"{sizes[shape.id].vertices} vertices"
        tiles.append(Tile(image, shape.id, note, shape.split))
    with atomic_path(path) as temporary:
        grid(tiles, min(_COLUMNS, len(tiles))).save(temporary, format="JPEG", quality=85)
    return path
