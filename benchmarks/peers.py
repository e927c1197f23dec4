"""Per-shape methods beside the figures of other authors' programs, as a Markdown table.

python benchmarks/peers.py MESHES FIGURES [--methods smat …] [--meshes heads/id012_neutral …]

MESHES holds collections, `<collection>/meshes/<shape>.ply`. FIGURES is a CSV with the columns
mesh (`<collection>/<shape>`), method, iso_mean, iso_max, con_mean, con_max. Every map must be
bijective.
"""

import argparse
import csv
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.progress import track

from gensp.geometry.certificate import certify
from gensp.geometry.mesh import load_mesh
from gensp.methods.table import per_shape

PEERS = {"smat": "smat_embedding", "stretch": "praun_hoppe", "ahsp": "praun_hoppe"}
COLUMNS = ("iso_mean", "iso_max", "con_mean", "con_max")
MESHES = (
    "heads/id012_neutral",
    "heads/id013_expr",
    "humans/60018_apose_00000",
    "mixed/cactus",
    "quadrupeds/horse_rest",
    "mixed/wingnut",
)
HEAD = (
    "| mesh | method | mean σ | max σ | mean σ^con | max σ^con | seconds | their program |\n"
    "|---|---|--:|--:|--:|--:|--:|---|"
)


def published(path: Path) -> dict[tuple[str, str], list[float]]:
    """The four distortions of every mesh and program that has them."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["iso_mean"]]
    return {(row["mesh"], row["method"]): [float(row[c]) for c in COLUMNS] for row in rows}


def measured(path: Path, method: str) -> tuple[list[float], float]:
    """The same four of our map, and its processor seconds."""
    mesh, start = load_mesh(path), time.process_time()
    map = per_shape(method)(mesh)
    seconds = time.process_time() - start
    certificate = certify(map.sphere, mesh.faces)
    if not certificate:
        sys.exit(f"{path}: {method}: {certificate}")
    found = map.distortion()
    return [found.mean, found.max, found.conformal_mean, found.conformal_max], seconds


def row(folder: Path, name: str, method: str, figures: dict[tuple[str, str], list[float]]) -> str:
    """One line: ours, and theirs in brackets."""
    collection, shape = name.split("/")
    ours, seconds = measured(folder / collection / "meshes" / f"{shape}.ply", method)
    theirs = figures.get((name, PEERS.get(method, "")), [float("nan")] * 4)
    cells = [f"{a:.3g} ({b:.3g})" for a, b in zip(ours, theirs, strict=True)]
    return f"| {name} | {method} | {' | '.join(cells)} | {seconds:.1f} | {PEERS.get(method, '')} |"


def main() -> None:
    """Measure every method on every mesh, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="MESHES", type=Path)
    parser.add_argument("figures", metavar="FIGURES", type=Path)
    parser.add_argument("--methods", nargs="+", default=list(PEERS))
    parser.add_argument("--meshes", nargs="+", default=list(MESHES))
    given = parser.parse_args()
    figures = published(given.figures)
    work = [(method, name) for method in given.methods for name in given.meshes]
    lines = [HEAD] + [
        row(given.folder, name, method, figures)
        for method, name in track(work, "measuring", console=Console(stderr=True))
    ]
    Console(width=200).print("\n".join(lines), markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
