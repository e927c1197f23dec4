"""How the time of a certified map grows with the valence of one vertex.

    OMP_NUM_THREADS=1 python benchmarks/valence.py --valences 250 500 1000 2000 4000

Closed cylinders as CAD programs write them, both caps a fan of triangles, with about `--vertices`
vertices whatever the valence: processor seconds of one core, after compilation.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from growth import measured, slope

from gensp.geometry.sphere import icosphere
from gensp.methods.table import DEFAULT, per_shape

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from fans import cylinder

VALENCES = (250, 500, 1000, 2000, 4000)


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
