"""`method=cmcf_raw` beside the program of the flow's authors.

    OMP_NUM_THREADS=1 python benchmarks/flow_peers.py MESHES docs/benchmark/programs.csv

MESHES and the CSV as in peers.py; the program's rows are named cmcf_100_steps, its column
seconds_one_core has seconds on one quiet core. Rows: where that program folds nothing, or was
timed. Printed are the figures of both, theirs in brackets; where nothing folds the largest
relative difference of the four distortions; and processor seconds.
"""

import argparse
import csv
import sys
import time
from pathlib import Path

import hydra
from rich.console import Console
from rich.progress import track

from gensp.geometry.mesh import load_mesh
from gensp.methods import SphericalParameterization

PROGRAM = "cmcf_100_steps"
COLUMNS = ("iso_mean", "iso_max", "con_mean", "con_max")


def authors_flow() -> SphericalParameterization:
    """The method as its configuration has it."""
    with hydra.initialize_config_module("conf", version_base="1.3"):
        method = hydra.compose("config", ["method=cmcf_raw"]).method.object
    made: SphericalParameterization = hydra.utils.instantiate(method)()
    return made


def line(method: SphericalParameterization, meshes: Path, theirs: dict[str, str]) -> str:
    """A row of the table."""
    collection, shape = theirs["mesh"].split("/")
    mesh = load_mesh(meshes / collection / "meshes" / f"{shape}.ply")
    began = time.process_time()
    map = method(mesh)
    seconds = time.process_time() - began
    found = map.distortion()
    ours = (found.mean, found.max, found.conformal_mean, found.conformal_max)
    known = [float(theirs[name]) for name in COLUMNS]
    apart = max(abs(a / b - 1) for a, b in zip(ours, known, strict=True))
    figures = [f"{a:.6g} ({b:.6g})" for a, b in zip(ours, known, strict=True)]
    bracket = f" ({theirs['seconds_one_core']})" if theirs["seconds_one_core"] else ""
    folds = theirs["bad_faces"] != "0"
    bad = f"{int(map.bad_faces().sum())} ({theirs['bad_faces']})"
    cells = [theirs["mesh"], *figures, bad, "" if folds else f"{apart:.1e}"]
    return f"| {' | '.join(cells)} | {seconds:.2f}{bracket} |\n"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("figures", type=Path)
    chosen = parser.parse_args()
    with open(chosen.figures, newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["method"] == PROGRAM]
    known = [
        r for r in rows if r["bad_faces"] == "0" or (r["bad_faces"] and r["seconds_one_core"])
    ]
    method = authors_flow()
    sys.stdout.write(
        "| mesh | mean σ | max σ | mean σ^con | max σ^con | bad faces | difference | seconds |\n"
        "|---|--:|--:|--:|--:|--:|--:|--:|\n"
    )
    for row in track(known, console=Console(stderr=True)):
        sys.stdout.write(line(method, chosen.meshes, row))


if __name__ == "__main__":
    main()
