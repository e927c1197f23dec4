"""`method=cmcf_raw` beside the program of the flow's authors.

    OMP_NUM_THREADS=1 python benchmarks/flow_peers.py MESHES docs/benchmark/programs.csv

MESHES and the CSV as in peers.py; the program's rows are named cmcf_100_steps, its column
seconds_one_core has seconds on one quiet core. Rows: where that program folds nothing, or was
timed. Printed are the figures of both, theirs in brackets; where nothing folds the largest
relative difference of the four distortions; and processor seconds.

    OMP_NUM_THREADS=1 python benchmarks/flow_peers.py MESHES docs/benchmark/programs.csv \
        --programs FOLDER

runs their program SphereMap, which you have built in FOLDER, by `method=external` instead, on the
meshes where the CSV says that it folds nothing. Printed are the largest distance between the two
places of a vertex after the best rotation, the folded faces of both, and the processor seconds of
both: theirs with reading and writing of the mesh.
"""

import argparse
import csv
import resource
import sys
from pathlib import Path

import hydra
import numpy as np
from rich.console import Console
from rich.progress import track

from gensp.geometry.alignment import best_rotation
from gensp.geometry.mesh import Mesh, load_mesh
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods import SphericalParameterization

PROGRAM = "cmcf_100_steps"
COLUMNS = ("iso_mean", "iso_max", "con_mean", "con_max")


HEAD = (
    "| mesh | mean σ | max σ | mean σ^con | max σ^con | bad faces | difference | seconds |\n"
    "|---|--:|--:|--:|--:|--:|--:|--:|\n"
)
HEAD_OF_POSITIONS = (
    "| mesh | vertices | largest difference | bad faces | seconds | ours / theirs |\n"
    "|---|--:|--:|--:|--:|--:|\n"
)


def composed(*words: str) -> SphericalParameterization:
    """A method as its configuration has it."""
    with hydra.initialize_config_module("conf", version_base="1.3"):
        method = hydra.compose("config", [*words]).method.object
    made: SphericalParameterization = hydra.utils.instantiate(method)()
    return made


def mesh_of(meshes: Path, name: str) -> Mesh:
    """`<collection>/<shape>` of the folder of collections."""
    collection, shape = name.split("/")
    return load_mesh(meshes / collection / "meshes" / f"{shape}.ply")


def timed(
    method: SphericalParameterization, mesh: Mesh, who: int = resource.RUSAGE_SELF
) -> tuple[SphericalMap, float]:
    """A map and the processor seconds of this process or of the programs that it runs."""
    before = resource.getrusage(who)
    map = method(mesh)
    after = resource.getrusage(who)
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return map, seconds


def position_line(
    method: SphericalParameterization, program: SphericalParameterization, mesh: Mesh, name: str
) -> str:
    """A row of the table of positions."""
    ours, seconds = timed(method, mesh)
    theirs, known = timed(program, mesh, resource.RUSAGE_CHILDREN)
    turned = ours.sphere @ best_rotation(ours.sphere, theirs.sphere).T
    apart = np.linalg.norm(turned - theirs.sphere, axis=1).max()
    bad = f"{int(ours.bad_faces().sum())} ({int(theirs.bad_faces().sum())})"
    return (
        f"| {name} | {len(mesh.vertices)} | {apart:.1e} | {bad} | {seconds:.2f} ({known:.2f}) "
        f"| {seconds / known:.2f} |\n"
    )


def line(method: SphericalParameterization, meshes: Path, theirs: dict[str, str]) -> str:
    """A row of the table."""
    map, seconds = timed(method, mesh_of(meshes, theirs["mesh"]))
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path)
    parser.add_argument("figures", type=Path)
    parser.add_argument("--programs", type=Path, help="folder of SphereMap: compare positions")
    chosen = parser.parse_args()
    with open(chosen.figures, newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["method"] == PROGRAM]
    method, progress = composed("method=cmcf_raw"), Console(stderr=True)
    if chosen.programs:
        words = ("method=external", "method.tool=SphereMap", f"method.programs={chosen.programs}")
        program = composed(*words)
        sys.stdout.write(HEAD_OF_POSITIONS)
        sound = [row["mesh"] for row in rows if row["bad_faces"] == "0"]
        for name in track(sound, console=progress):
            sys.stdout.write(position_line(method, program, mesh_of(chosen.meshes, name), name))
        return
    known = [
        r for r in rows if r["bad_faces"] == "0" or (r["bad_faces"] and r["seconds_one_core"])
    ]
    sys.stdout.write(HEAD)
    for row in track(known, console=progress):
        sys.stdout.write(line(method, chosen.meshes, row))


if __name__ == "__main__":
    main()
