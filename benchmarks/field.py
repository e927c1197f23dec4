"""How much of thin limbs the implicit field of Stage II has.

    python benchmarks/field.py RUNS/quadrupeds/full/augment RUNS/quadrupeds/full*/implicit

A row for every finished stage=implicit. Of every input shape, points of its surface are asked how
far the zero level set of its code is, in lengths of the unit sphere (shapes have area 4π): all
points, and those of the thinnest tenth of the surface by local thickness. Largest distances are of
one point of a shape, mean over shapes. A floating part of a level set does not count, as it does
not in Stage III. Without surface: shapes whose code has no level set.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

from gensp.data.items import item_mesh
from gensp.errors import EmptyLevelSet
from gensp.files import load_npz, read_json
from gensp.geometry.distance import closest_point
from gensp.geometry.isosurface import extract_surface
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.thickness import medial_ball_radii
from gensp.models.implicit import ImplicitField
from gensp.models.store import load_model
from gensp.tasks.correspond import is_input

THIN = 0.1
COLUMNS = ("mean", "mean of thin", "95 % of thin", "largest")


def gaps(mesh: Mesh, surface: Mesh, count: int) -> np.ndarray:
    """Distances from a shape to a surface: mean, mean and 95 % of its thin parts, largest."""
    at = sample_surface(mesh.face_areas, count, np.random.default_rng(0))
    found = closest_point(at.on(mesh.vertices, mesh.faces), surface).distance
    radii = medial_ball_radii(mesh)[mesh.faces].mean(axis=1)[at.faces]
    thin = found[radii <= np.quantile(radii, THIN)]
    return np.array([found.mean(), thin.mean(), np.quantile(thin, 0.95), found.max()])


def level_set(field: ImplicitField, code: np.ndarray, mesh: Mesh, resolution: int) -> Mesh:
    """The zero level set of a code, in a box around the shape that it is of."""
    z = torch.as_tensor(code, dtype=torch.float32)[None]
    return extract_surface(
        lambda x: field(z, x[None])[0],
        resolution=resolution,
        vertices=None,
        bounds=1.25 * float(np.abs(mesh.vertices).max()),
        require_genus_zero=False,
    )


def measure(augment: Path, run: Path, points: int, resolution: int) -> tuple[np.ndarray, int, int]:
    """Mean of `gaps` over shapes, how many shapes there are, and how many have no surface."""
    field = load_model(run / "model.pt")["field"]
    assert isinstance(field, ImplicitField)
    latents = load_npz(run / "latents.npz")
    codes = dict(zip(map(str, latents["ids"]), latents["codes"], strict=True))
    rows, lost = [], 0
    for id in filter(is_input, codes):
        mesh = item_mesh(augment, id)
        try:
            rows.append(gaps(mesh, level_set(field, codes[id], mesh, resolution), points))
        except EmptyLevelSet:
            lost += 1
    return np.mean(rows, axis=0) if rows else np.full(len(COLUMNS), np.nan), len(rows) + lost, lost


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("augment", type=Path, help="finished stage=augment: the shapes")
    parser.add_argument("runs", type=Path, nargs="+", help="folders of finished stage=implicit")
    parser.add_argument("--points", type=int, default=4000, help="of every surface")
    parser.add_argument("--resolution", type=int, default=96, help="cells of the level set's grid")
    chosen = parser.parse_args()
    head = " | ".join(COLUMNS)
    sys.stdout.write(f"| stage | {head} | shapes | without surface | seconds |\n")
    sys.stdout.write("|---|" + "--:|" * (len(COLUMNS) + 3) + "\n")
    for run in chosen.runs:
        means, shapes, lost = measure(chosen.augment, run, chosen.points, chosen.resolution)
        figures = " | ".join(f"{value:.4f}" for value in means)
        seconds = read_json(run / "manifest.json")["seconds"]
        sys.stdout.write(
            f"| {run.parent.name} | {figures} | {shapes} | {lost} | {seconds:.0f} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
