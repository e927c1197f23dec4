"""How the time of a certified map grows with the vertices of one and the same shape.

    OMP_NUM_THREADS=1 python benchmarks/growth.py MESH … --sizes 3000 6000 12500 25000 50000

Every mesh is simplified to the sizes given that are smaller than it, and mapped at each and as it
is: processor seconds of one core, after compilation. The exponent is the slope of log seconds over
log vertices, one of each shape and one that all shapes have in common. Over meshes of different
shapes (`certify.py`) limbs count as much as sizes do.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from gensp.geometry.mesh import Mesh, load_mesh, simplify
from gensp.geometry.sphere import icosphere
from gensp.methods.table import DEFAULT, per_shape

SIZES = (3000, 6000, 12500, 25000, 50000)


def measured(mesh: Mesh, method: str) -> tuple[int, float, float]:
    """Vertices, processor seconds and mean σ of a map, which must be bijective."""
    start = time.process_time()
    found = per_shape(method)(mesh)
    seconds = time.process_time() - start
    assert found.certify(), mesh.name
    return len(mesh.vertices), seconds, found.distortion().mean


def slope(sizes: np.ndarray, seconds: np.ndarray) -> float:
    """Exponent of one shape."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def common_slope(shapes: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Exponent that shapes of different costs have in common."""
    pairs = [(np.log(n) - np.log(n).mean(), np.log(s) - np.log(s).mean()) for n, s in shapes]
    x, y = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(x @ y / (x @ x))


def main() -> None:
    """Print a row for every mesh and size, and the exponents."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", type=Path, nargs="+")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--method", default=DEFAULT)
    words = parser.parse_args()
    per_shape(words.method)(icosphere(2))  # compiles
    shapes = []
    sys.stdout.write("| mesh | vertices | seconds | mean σ |\n|---|--:|--:|--:|\n")
    for path in words.meshes:
        whole = load_mesh(path)
        smaller = [simplify(whole, n) for n in words.sizes if n < 0.9 * len(whole.vertices)]
        rows = np.array([measured(mesh, words.method) for mesh in [*smaller, whole]])
        for count, seconds, sigma in rows:
            sys.stdout.write(f"| {path.stem} | {count:,.0f} | {seconds:.2f} | {sigma:.3f} |\n")
        shapes.append((rows[:, 0], rows[:, 1]))
        sys.stdout.write(f"| {path.stem} | | n^{slope(*shapes[-1]):.2f} | |\n")
        sys.stdout.flush()
    sys.stdout.write(f"| all | | n^{common_slope(shapes):.2f} | |\n")


if __name__ == "__main__":
    main()
