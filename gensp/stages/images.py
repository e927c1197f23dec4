"""What both kinds of Stage III-a leave: images of the icosphere, and shapes that have none."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gensp.compute import Row
from gensp.errors import RegistrationFailed
from gensp.files import save_npz
from gensp.geometry.consistency import coverage
from gensp.geometry.correspondence import Correspondence
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere_of
from gensp.layout import item_file
from gensp.tasks.correspond import is_input
from gensp.terminal import warn


def write_image(folder: Path, id: str, found: Correspondence, mesh: Mesh, depth: int) -> Row:
    """Write a shape's correspondences; a row that tells how much of the shape they reach."""
    path = item_file(folder, "correspondences", id)
    save_npz(path, points=found.points, valid=found.valid)
    image = Mesh(found.points, icosphere_of(len(found.points)).faces, id)
    gaps = coverage(mesh, image)
    return {
        "id": id,
        "input": is_input(id),
        "depth": depth,
        "fold_rate": found.fold_rate,
        "valid": float(found.valid.mean()),
        "coverage": gaps.mean,
        "coverage_max": gaps.max,
    }


def lost_rows(lost: Sequence[str]) -> list[Row]:
    """Rows of the inputs that no registration reached."""
    return [{"id": id, "error": "no registration reached it"} for id in lost]


def require_few(folder: Path, lost: Sequence[str], most: int, remedy: str) -> None:
    """Name the inputs that no registration reached.

    Raises
    ------
    RegistrationFailed
        More than `most` are lost; the message ends with `remedy`.
    """
    if len(lost) > most:
        raise RegistrationFailed(
            f"{folder}: {len(lost)} input shapes ({', '.join(lost[:5])}) have no accepted "
            f"registration, at most {most} may lack one; see edges.csv; widen "
            f"recipe.correspond.acceptance, {remedy}, or raise recipe.correspond.max_failures"
        )
    if lost:
        warn(
            f"{len(lost)} input shapes ({', '.join(lost)}) have no accepted registration and "
            f"are not learnt from; see {folder / 'shapes.csv'}"
        )


def image_metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Means over the images of the inputs."""
    inputs = [row for row in rows if row["input"]]
    return {name: mean_of(inputs, name) for name in ("coverage", "fold_rate", "valid", "depth")}


def mean_of(rows: Sequence[Row], name: str) -> float:
    """Mean of a column where it is there; NaN without rows."""
    values = [float(row[name] or 0) for row in rows if name in row]
    return float(np.mean(values)) if values else float("nan")
