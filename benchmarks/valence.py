"""How the time of a certified map grows with the valence of one vertex.

    OMP_NUM_THREADS=1 python benchmarks/valence.py --valences 250 500 1000 2000 4000

Closed cylinders as CAD programs write them, both caps a fan of triangles, with about `--vertices`
vertices whatever the valence: processor seconds of one core, after compilation.
"""

import argparse
import sys

import numpy as np
from growth import measured, slope

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.methods.table import DEFAULT, per_shape

VALENCES = (250, 500, 1000, 2000, 4000)


def cylinder(valence: int, rings: int) -> Mesh:
    """A cylinder of diameter and height 2, its caps fans of `valence` triangles."""
    angles = 2 * np.pi * np.arange(valence) / valence
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    heights = np.repeat(np.linspace(-1, 1, rings), valence)
    side = np.column_stack([np.tile(rim, (rings, 1)), heights])
    here = np.arange(valence * (rings - 1))
    turned = np.where(here % valence == valence - 1, here + 1 - valence, here + 1)
    quads = [[here, turned, turned + valence], [here, turned + valence, here + valence]]
    bottom, top = len(side), len(side) + 1
    low, high = here[:valence], here[:valence] + valence * (rings - 1)
    onward = turned[:valence]
    fans = [
        [np.full(valence, bottom), onward, low],
        [np.full(valence, top), high, onward + valence * (rings - 1)],
    ]
    faces = np.concatenate([np.column_stack(part) for part in quads + fans])
    vertices = np.concatenate([side, [[0, 0, -1.0], [0, 0, 1.0]]])
    return Mesh(vertices, faces, f"fans of {valence}")


def main() -> None:
    """Print a row for every valence, and the exponent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--valences", type=int, nargs="+", default=VALENCES)
    parser.add_argument("--vertices", type=int, default=8000)
    parser.add_argument("--method", default=DEFAULT)
    words = parser.parse_args()
    per_shape(words.method)(icosphere(4))  # compiles
    rows = []
    sys.stdout.write("| valence | vertices | seconds | mean σ |\n|--:|--:|--:|--:|\n")
    for valence in words.valences:
        rings = max(2, round(words.vertices / valence))
        rows.append((valence, *measured(cylinder(valence, rings), words.method)))
        sys.stdout.write("| {:,} | {:,} | {:.2f} | {:.3f} |\n".format(*rows[-1]))
        sys.stdout.flush()
    columns = np.array(rows).T
    sys.stdout.write(f"| | | valence^{slope(columns[0], columns[2]):.2f} | |\n")


if __name__ == "__main__":
    main()
