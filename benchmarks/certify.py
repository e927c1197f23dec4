"""Certified maps of all meshes of some folders on one core: how many, how distorted, how fast.

OMP_NUM_THREADS=1 python benchmarks/certify.py data/heads/meshes data/quadrupeds/meshes

With --maps the maps of a finished run are measured in place of new ones; `seconds` are of reading.
With --figures each row has the least mean and the least maximum of σ_t that other programs have on
that mesh, and whose they are.
"""

import argparse
import csv
import time
from pathlib import Path

import numpy as np

from gensp.errors import BadMesh, GenSPError
from gensp.files import atomic_path
from gensp.geometry.mesh import FORMATS, load_mesh, require_genus_zero
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import load_map
from gensp.layout import item_file
from gensp.methods.table import DEFAULT, per_shape

OURS = ["mesh", "vertices", "seconds", "bijective", "sigma_mean", "sigma_max"]
THEIRS = ["sigma_mean_theirs", "sigma_mean_by", "sigma_max_theirs", "sigma_max_by"]

Row = dict[str, object]


def line(path: Path, method: str, maps: Path | None) -> Row:
    """One mesh: its map's certificate, distortion and processor seconds, or why there is none."""
    row: Row = {"mesh": f"{path.parent.parent.name}/{path.stem}"}
    try:
        mesh = load_mesh(path)
        require_genus_zero(mesh)
    except BadMesh as error:
        return row | {"unusable": str(error)}
    start = time.process_time()
    try:
        map = per_shape(method)(mesh) if maps is None else load_map(_kept(maps, path.stem))
    except GenSPError as error:
        return row | {"vertices": len(mesh.vertices), "failed": str(error)}
    distortion = map.distortion()
    return row | {
        "vertices": len(mesh.vertices),
        "seconds": round(time.process_time() - start, 2),
        "bijective": map.certify().bijective,
        "sigma_mean": round(distortion.mean, 4),
        "sigma_max": round(distortion.max, 3),
    }


def _kept(maps: Path, id: str) -> Path:
    return item_file(maps.parent, maps.name, id)


def growth(rows: list[Row]) -> str:
    """How the seconds grow with the vertices, over all meshes."""
    known = [[row["vertices"], row["seconds"]] for row in rows if "bijective" in row]
    return f"seconds grow as n^{np.polyfit(*np.log(known).T, 1)[0]:.2f}"


def summary(rows: list[Row]) -> str:
    """What the table says, in one line."""
    mapped = [row for row in rows if "bijective" in row]
    bijective = sum(bool(r["bijective"]) for r in mapped)
    failed, unusable = (sum(key in r for r in rows) for key in ("failed", "unusable"))
    return f"{bijective} of {len(mapped)} maps bijective; {failed} failed; {unusable} unusable"


def beside(rows: list[Row], figures: Path) -> list[Row]:
    """The rows with the best of other programs: their least mean and least maximum of σ_t.

    `figures` is a csv with the columns mesh, method, iso_mean and iso_max, several lines a mesh.
    """
    known: dict[str, list[tuple[float, float, str]]] = {}
    with open(figures, newline="") as file:
        for row in csv.DictReader(file):
            if row["iso_mean"] and row["iso_max"]:
                found = float(row["iso_mean"]), float(row["iso_max"]), row["method"]
                known.setdefault(row["mesh"], []).append(found)
    return [row | _best(known.get(str(row["mesh"]), [])) for row in rows]


def _best(known: list[tuple[float, float, str]]) -> Row:
    if not known:
        return {}
    mean, most = (min(known, key=lambda found, k=k: found[k]) for k in range(2))
    return dict(zip(THEIRS, (mean[0], mean[2], most[1], most[2]), strict=True))


def compare(rows: list[Row]) -> str:
    """The maps of `beside` in one line."""
    known = [row for row in rows if THEIRS[0] in row and row.get("sigma_mean")]
    ours = np.array([[float(r["sigma_mean"]), float(r["sigma_max"])] for r in known])
    mean, most = (ours / np.array([[r[THEIRS[0]], r[THEIRS[2]]] for r in known])).T
    return (
        f"{len(known)} meshes beside the best of other programs: mean σ at most theirs on "
        f"{np.mean(mean <= 1):.0%}, at worst {mean.max():.3f} times; max σ "
        f"{most.mean():.3f} times on average, above theirs on {np.mean(most > 1):.0%}"
    )


def main() -> None:
    """Read the command line, print a line per mesh, write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="folders of meshes")
    parser.add_argument("--method", default=DEFAULT)
    parser.add_argument("--maps", type=Path, help="folder maps/ of stage=parameterize")
    parser.add_argument("--out", type=Path, help="csv")
    parser.add_argument("--figures", type=Path, help="csv of other programs, see beside")
    words = parser.parse_args()
    per_shape(words.method)(icosphere(2))  # compiles
    paths = [
        p for folder in words.folders for p in sorted(folder.iterdir()) if p.suffix in FORMATS
    ]
    rows = []
    for path in paths:
        rows.append(line(path, words.method, words.maps))
        print(rows[-1], flush=True)  # noqa: T201
    print(summary(rows))  # noqa: T201
    if words.maps is None:
        print(growth(rows))  # noqa: T201
    if words.figures:
        rows = beside(rows, words.figures)
        print(compare(rows))  # noqa: T201
    if words.out:
        save(rows, words.out)


def save(rows: list[Row], path: Path) -> None:
    """Write the table; columns that no row has are left out."""
    names = [
        name for name in [*OURS, *THEIRS, "failed", "unusable"] if any(name in r for r in rows)
    ]
    with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
        table = csv.DictWriter(file, names, restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    main()
