"""What a folder of meshes holds: its manifest, or every mesh file, and their splits."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gensp.errors import MissingData, Unsupported
from gensp.files import read_rows
from gensp.geometry.formats import FORMATS

SPLITS = ("train", "val", "test")
# Columns of a manifest that say what a mesh is, not how it is stored.
COLUMNS = ("category", "template", "subject", "pose", "source", "licence")


@dataclass(frozen=True)
class Shape:
    """One mesh file of a collection; shapes of one template share ground-truth ids.

    `columns` are those of `COLUMNS` that the manifest fills.
    """

    id: str
    path: Path
    split: str = "train"
    template: str | None = None
    correspondence: Path | None = None
    columns: tuple[tuple[str, str], ...] = ()


def read_manifest(root: Path) -> list[Shape]:
    """The shapes that `manifest.csv` names.

    Raises
    ------
    MissingData
        It has no rows or no column "file", or names an unknown split.
    """
    path = root / "manifest.csv"
    rows = read_rows(path)
    if not rows or "file" not in rows[0]:
        raise MissingData(
            f"{path}: has no rows with a column 'file'; a manifest names file, split and "
            "optionally category and correspondence; complete it or remove it"
        )
    return [_shape(root, row, path) for row in rows]


def _shape(root: Path, row: dict[str, str], manifest: Path) -> Shape:
    split = row.get("split") or "train"
    if split not in SPLITS:
        raise MissingData(
            f"{manifest}: {row['file']} has the split '{split}'; one of {', '.join(SPLITS)} is "
            "required; correct the column"
        )
    dense = [part for part in (row.get("correspondence") or "").split(";") if part[-4:] == ".npz"]
    return Shape(
        id=Path(row["file"]).stem,
        path=root / row["file"],
        split=split,
        template=row.get("template") or row.get("category") or root.name if dense else None,
        correspondence=root / dense[0] if dense else None,
        columns=tuple((key, row[key]) for key in COLUMNS if row.get(key)),
    )


def list_meshes(root: Path, name: str) -> list[Shape]:
    """Every mesh file below `meshes/`, or below the folder itself where there is none.

    Raises
    ------
    MissingData
        There is no mesh.
    """
    folder = root / "meshes" if (root / "meshes").is_dir() else root
    files = [
        file
        for file in sorted(folder.rglob("*"))
        if file.suffix.lower() in FORMATS and not file.name.startswith(".")
    ]
    if not files:
        raise MissingData(
            f"{root}: holds no mesh; files in {', '.join(FORMATS)} are required; set "
            "shapes.root=FOLDER"
        )
    shapes = []
    for file in files:
        id = "_".join(file.relative_to(folder).with_suffix("").parts)
        dense = root / "corr" / f"{id}.npz"
        known = (name, dense) if dense.is_file() else (None, None)
        shapes.append(Shape(id, file, template=known[0], correspondence=known[1]))
    return shapes


def with_split(shapes: list[Shape], test_fraction: float, seed: int) -> list[Shape]:
    """The shapes with a share held out, see `held_out`."""
    test = held_out(len(shapes), test_fraction, seed)
    return [
        replace(shape, split="test" if index in test else "train")
        for index, shape in enumerate(shapes)
    ]


def held_out(count: int, test_fraction: float, seed: int) -> set[int]:
    """Places of the share of `count` shapes that is held out for testing, drawn by the seed.

    Raises
    ------
    Unsupported
        Nothing would be left for training.
    """
    number = round(test_fraction * count)
    if not 0 <= number < max(count, 1):
        raise Unsupported(
            f"shapes.test_fraction={test_fraction}: holds out {number} of {count} shapes; "
            "at least one must be left for training; choose a share below 1"
        )
    return set(np.random.default_rng(seed).permutation(count)[:number].tolist())
