"""What stage=prepare costs, and how that grows: processor seconds and bytes on disk.

OMP_NUM_THREADS=1 python benchmarks/prepare_costs.py --out prepare --ways check remesh
OMP_NUM_THREADS=1 python benchmarks/prepare_costs.py --out prepare --ways solid --counts 1 2 4

Raw meshes are generated blobs, with every edge halved as often as `--vertices` asks for: for each
of `--counts` with the least of `--vertices`, and for all of these with the least count. They are
prepared in three ways: `check`, sound meshes that are looked at alone; `remesh`, sound meshes that
get triangles of their own (as shapes=dfaust); `solid`, pairs of blobs that pass through each
other, of which the outer surface is taken (as shapes=shapenet). Nothing is kept from one call to
the next. Figures are processor time of one thread.
"""

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import igl
import numpy as np
from cost_tables import exponent, plain, show
from costs import spent
from hydra import compose, initialize_config_dir

from gensp.data.blobs import BlobFamily, blob_samples
from gensp.files import read_json, write_json
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.run import run

ROOT = Path(__file__).parents[1]
COARSE = 600
WAYS = {
    "check": (),
    "remesh": ("recipe.prepare.remesh=true",),
    "solid": ("recipe.prepare.repair=[solid]",),
}
Row = dict[str, Any]


def refined(mesh: Mesh, vertices: int) -> Mesh:
    """Every edge halved until there are about so many vertices."""
    points, faces = mesh.vertices, mesh.faces
    while len(points) < 0.7 * vertices:
        points, faces = igl.upsample(points, faces)
    return Mesh(points, np.asarray(faces, dtype=np.int64), mesh.name)


def twofold(mesh: Mesh) -> Mesh:
    """A mesh and its copy, which pass through each other."""
    moved = mesh.vertices + 0.2 * np.array([1.0, 0.5, 0.25])
    faces = np.vstack([mesh.faces, mesh.faces + len(mesh.vertices)])
    return Mesh(np.vstack([mesh.vertices, moved]), faces, mesh.name)


def write_raw(folder: Path, blobs: Sequence[Mesh], vertices: int, way: str) -> None:
    """The raw meshes of one size."""
    shutil.rmtree(folder, ignore_errors=True)
    for number, blob in enumerate(blobs):
        # Both halves of a twofold mesh count.
        mesh = twofold(refined(blob, vertices // 2)) if "solid" in way else refined(blob, vertices)
        save_mesh(mesh, folder / f"{number}.ply")


def cost(out: Path, blobs: Sequence[Mesh], vertices: int, way: str) -> Row:
    """Processor seconds of the stage, and bytes of the collection."""
    for name in ("cache", "runs", "made"):
        shutil.rmtree(out / name, ignore_errors=True)
    write_raw(out / "raw", blobs, vertices, way)
    words = ["stage=prepare", "shapes=folder", f"shapes.root={out / 'raw'}", "name=prepare"]
    words += [f"paths.runs={out / 'runs'}", f"paths.cache={out / 'cache'}"]
    words += [f"prepare.out={out / 'made'}", "workers.jobs=1", "threads=1", *WAYS[way]]
    began = spent()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        run(compose("config", overrides=words), words)
    seconds = spent() - began
    files = [path for path in (out / "made").rglob("*") if path.is_file()]
    kept = len([path for path in files if path.suffix == ".ply"])
    row = {"way": way, "shapes": len(blobs), "vertices": vertices, "kept": kept}
    return {**row, "seconds": seconds, "bytes": sum(path.stat().st_size for path in files)}


def measure(
    out: Path, ways: Sequence[str], counts: Sequence[int], vertices: Sequence[int]
) -> list[Row]:
    """A row for every way and size; those that prepare.json has are kept."""
    path = out / "prepare.json"
    rows: list[Row] = read_json(path) if path.is_file() else []
    blobs = [mesh for mesh, _ in blob_samples(BlobFamily(count=max(counts), vertices=COARSE))]
    least = min(counts)
    sizes = dict.fromkeys([*((n, min(vertices)) for n in counts), *((least, v) for v in vertices)])
    for way in ways:
        known = {(row["shapes"], row["vertices"]) for row in rows if row["way"] == way}
        missing = [size for size in sizes if size not in known]
        if missing:
            cost(out, blobs[:1], min(vertices), way)  # what is loaded first counts in none
        for count, size in missing:
            rows.append(cost(out, blobs[:count], size, way))
            write_json(path, rows)
    return rows


def table(rows: Sequence[Row], along: str) -> list[str]:
    """A line for every way: costs at all sizes, exponents, cost of one more."""
    other = "vertices" if along == "shapes" else "shapes"
    lines = [f"| prepare | {along}: seconds | exponent | each | exponent of bytes | bytes each |"]
    lines.append("|---|---|---|---|---|---|")
    for way in dict.fromkeys(row["way"] for row in rows):
        mine = [row for row in rows if row["way"] == way]
        fixed = min(row[other] for row in mine)
        chosen = sorted((row for row in mine if row[other] == fixed), key=lambda row: row[along])
        sizes = [row[along] for row in chosen]
        cells = [", ".join(f"{row[along]:,}: {plain(row['seconds'])}" for row in chosen)]
        for what, form in (("seconds", ".3g"), ("bytes", ",.0f")):
            costs = [row[what] for row in chosen]
            each = (costs[-1] - costs[0]) / (sizes[-1] - sizes[0])
            cells += [f"{exponent(sizes, costs):.2f}", format(each, form)]
        lines.append(f"| {' | '.join([way, *cells])} |")
    return lines


def main() -> None:
    """Measure and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--counts", type=int, nargs="+", default=[4, 16, 64])
    parser.add_argument("--vertices", type=int, nargs="+", default=[600, 2400, 9600])
    given = parser.parse_args()
    rows = measure(given.out.resolve(), given.ways, given.counts, given.vertices)
    show(table(rows, "shapes"), table(rows, "vertices"))


if __name__ == "__main__":
    main()
