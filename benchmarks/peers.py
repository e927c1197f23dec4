"""Per-shape methods beside the figures of other authors' programs.

    OMP_NUM_THREADS=1 python benchmarks/peers.py MESHES docs/benchmark/programs.csv \
        --csv docs/benchmark/peers.csv

MESHES holds collections, `<collection>/meshes/<shape>.ply`. The first CSV has the columns
mesh (`<collection>/<shape>`), method, vertices, iso_mean, iso_max, con_mean, con_max. Every mesh
is mapped that has a figure of any program compared with and no more than --largest vertices.
Every map must be bijective. The CSV has ours and theirs of every mesh and method, written as they
come; printed are the same as a Markdown table, the quantiles of the ratios ours/theirs, and on how
many meshes two methods come in the same order as their programs. With --read nothing is measured;
the rows are those of --csv.
"""

import argparse
import csv
import sys
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from gensp.geometry.certificate import certify
from gensp.geometry.mesh import load_mesh
from gensp.geometry.sphere import icosphere
from gensp.methods import SphericalParameterization
from gensp.methods.hierarchical import smat
from gensp.methods.table import per_shape

PROGRAMS = {"smat": "smat_embedding", "stretch": "praun_hoppe", "ahsp": ""}
COLUMNS = ("iso_mean", "iso_max", "con_mean", "con_max")
SYMBOLS = ("mean σ", "max σ", "mean σ^con", "max σ^con")
QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)
NAMES = ["mesh", "method", "vertices", *COLUMNS, *[f"{c}_theirs" for c in COLUMNS], "seconds"]
HEAD = f"| mesh | method | {' | '.join(SYMBOLS)} | seconds |\n|---|---|--:|--:|--:|--:|--:|"

Figures = dict[tuple[str, str], dict[str, str]]
Row = dict[str, str | float]


def published(path: Path) -> Figures:
    """The rows of every mesh and program that have distortions."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["iso_mean"]]
    return {(row["mesh"], row["method"]): row for row in rows}


def comparable(figures: Figures, largest: int) -> list[str]:
    """Meshes of at most so many vertices with a figure of a program that is compared with."""
    return sorted(
        {
            mesh
            for (mesh, program), row in figures.items()
            if program in PROGRAMS.values() and int(row["vertices"]) <= largest
        }
    )


def measured(
    folder: Path, name: str, method: str, figures: Figures, mapping: SphericalParameterization
) -> Row:
    """Ours and theirs on one mesh, and our processor seconds."""
    collection, shape = name.split("/")
    mesh = load_mesh(folder / collection / "meshes" / f"{shape}.ply")
    start = time.process_time()
    map = mapping(mesh)
    seconds = time.process_time() - start
    certificate = certify(map.sphere, mesh.faces)
    if not certificate:
        sys.exit(f"{name}: {method}: {certificate}")
    found = map.distortion()
    ours = (found.mean, found.max, found.conformal_mean, found.conformal_max)
    theirs = figures.get((name, PROGRAMS[method]), {})
    row: Row = {"mesh": name, "method": method, "vertices": len(mesh.vertices)}
    row |= {column: float(f"{value:.6g}") for column, value in zip(COLUMNS, ours, strict=True)}
    row |= {f"{column}_theirs": theirs.get(column, "") for column in COLUMNS}
    return row | {"seconds": round(seconds, 2)}


def line(row: Row) -> str:
    """One row of the table: ours, and theirs in brackets."""
    cells = []
    for column in COLUMNS:
        theirs = row[f"{column}_theirs"]
        cells.append(f"{row[column]:.3g}" + (f" ({float(theirs):.3g})" if theirs else ""))
    return f"| {row['mesh']} | {row['method']} | {' | '.join(cells)} | {row['seconds']:.1f} |"


def quantiles(rows: list[Row]) -> list[str]:
    """Quantiles of ours/theirs for every method that has a program to be compared with."""
    lines = [
        f"| method | ours / theirs | meshes | {' | '.join(f'{q:.0%}' for q in QUANTILES)} |",
        f"|---|---|--:|{'--:|' * len(QUANTILES)}",
    ]
    for method in PROGRAMS:
        pairs = [row for row in rows if row["method"] == method and row["iso_mean_theirs"]]
        for column, symbol in zip(COLUMNS, SYMBOLS, strict=True):
            ratios = [float(row[column]) / float(row[f"{column}_theirs"]) for row in pairs]
            if ratios:
                cells = " | ".join(f"{value:.3f}" for value in np.quantile(ratios, QUANTILES))
                lines.append(f"| {method} | {symbol} | {len(ratios)} | {cells} |")
    return lines


def orders(rows: list[Row]) -> list[str]:
    """On how many meshes the better of two methods is the one whose program is the better."""
    lines = ["| methods | figure | same order |", "|---|---|--:|"]
    known = {(row["mesh"], row["method"]): row for row in rows if row["iso_mean_theirs"]}
    for pair in combinations([name for name, program in PROGRAMS.items() if program], 2):
        meshes = [m for m in {m for m, _ in known} if all((m, name) in known for name in pair)]
        for column, symbol in zip(COLUMNS, SYMBOLS, strict=True):
            same = [
                _first_is_less(known, mesh, pair, column)
                == _first_is_less(known, mesh, pair, f"{column}_theirs")
                for mesh in meshes
            ]
            lines.append(f"| {', '.join(pair)} | {symbol} | {sum(same)} of {len(same)} |")
    return lines if len(lines) > 2 else []


def _first_is_less(
    known: dict[tuple[str, str], Row], mesh: str, pair: tuple[str, ...], column: str
) -> bool:
    one, two = (float(known[mesh, name][column]) for name in pair)
    return one < two


def main() -> None:
    """Measure every method on every mesh, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="MESHES", type=Path)
    parser.add_argument("figures", metavar="FIGURES", type=Path)
    parser.add_argument("--methods", nargs="+", choices=PROGRAMS, default=list(PROGRAMS))
    parser.add_argument("--meshes", nargs="+", help="instead of all that have a figure")
    parser.add_argument("--largest", type=int, default=9000, help="vertices (default: 9000)")
    parser.add_argument("--barrier", type=float, default=1.0, help="of smat (default: 1)")
    parser.add_argument("--angle", type=float, default=100.0, help="of smat (default: 100)")
    parser.add_argument("--area", type=float, default=1.0, help="of smat (default: 1)")
    parser.add_argument("--csv", type=Path, help="file for the figures of every mesh")
    parser.add_argument("--read", action="store_true", help="rows of --csv; measure nothing")
    given = parser.parse_args()
    if given.read:
        if given.csv is None:
            parser.error("--read: --csv FILE is required, a file that this script wrote")
        report(read(given.csv))
        return
    figures = published(given.figures)
    names = given.meshes or comparable(figures, given.largest)
    work = [(method, name) for method in given.methods for name in names]
    mappings = {method: per_shape(method) for method in given.methods}
    if "smat" in mappings:
        mappings["smat"] = smat(barrier=given.barrier, angle=given.angle, area=given.area)
    for mapping in mappings.values():
        mapping(icosphere(2))  # compiles
    rows: list[Row] = []
    for method, name in track(work, "measuring", console=Console(stderr=True)):
        rows.append(measured(given.folder, name, method, figures, mappings[method]))
        if given.csv:
            save(rows, given.csv)
    report(rows)


def report(rows: list[Row]) -> None:
    """Print the tables."""
    tables = [HEAD, *map(line, rows), "", *quantiles(rows), "", *orders(rows)]
    sys.stdout.write("\n".join([*tables, ""]))


def read(path: Path) -> list[Row]:
    """The rows that `save` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            row | {name: float(row[name]) for name in (*COLUMNS, "seconds")}
            for row in csv.DictReader(file)
        ]


def save(rows: list[Row], path: Path) -> None:
    """Write what is measured so far."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, NAMES, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
