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
    """A cylinder of radius 1 and height 2; the last two vertices have `valence` neighbours."""
    angles = 2 * np.pi * np.arange(valence) / valence
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    heights = np.repeat(np.linspace(-1, 1, rings), valence)
    vertices = np.column_stack([np.tile(rim, (rings, 1)), heights])
    below = np.arange(valence * (rings - 1))
    onward = below + np.where(below % valence == valence - 1, 1 - valence, 1)
    quads = [[below, onward, onward + valence], [below, onward + valence, below + valence]]
    low, beside, up = below[:valence], onward[:valence], valence * (rings - 1)
    foot = np.full(valence, len(vertices))
    fans = [[foot, beside, low], [foot + 1, low + up, beside + up]]
    faces = np.concatenate([np.column_stack(part) for part in quads + fans])
    return Mesh(np.concatenate([vertices, [[0, 0, -1.0], [0, 0, 1.0]]]), faces, "cylinder")


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
