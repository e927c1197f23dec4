"""One edge of stage III at 2,500 vertices on one core.

python benchmarks/registration.py
"""

import time
from pathlib import Path

from gensp.geometry.mesh import Mesh, load_mesh, normalize, simplify
from gensp.geometry.registration import Registration, register

MESHES = Path(__file__).parents[1] / "data" / "heads" / "meshes"
VERTICES = 2500
REPEATS = 3


def head(id: str) -> Mesh:
    """A head of the embedded collection, normalised and simplified."""
    return simplify(normalize(load_mesh(MESHES / f"{id}.ply")), VERTICES)


def timed(source: Mesh, target: Mesh) -> tuple[float, Registration]:
    """Processor seconds of one registration with the default schedule."""
    start = time.process_time()
    result = register(source, [target])
    return time.process_time() - start, result


def measure() -> list[dict[str, object]]:
    """Least seconds of an edge between two different heads, and how well it fits."""
    source, target = head("id000_neutral"), head("id005_expr")
    runs = [timed(source, target) for _ in range(REPEATS)]
    result = runs[0][1]
    rows = [
        ("registration, one edge at 2,500 vertices", min(run[0] for run in runs), "s", "≤ 1"),
        ("registration, distance to the target", result.residual, "of √(area/4π)", ""),
        ("registration, distance from the target", result.coverage, "of √(area/4π)", ""),
        ("registration, folded faces", 100 * result.fold_rate, "%", ""),
    ]
    return [
        {"name": name, "figure": figure, "unit": unit, "required": required}
        for name, figure, unit, required in rows
    ]


if __name__ == "__main__":
    for line in measure():
        print("{name:60s} {figure:8.3g} {unit:2s} {required}".format(**line))  # noqa: T201
