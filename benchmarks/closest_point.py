"""Closest points and signed distances against a 40k-vertex surface on one core.

python benchmarks/closest_point.py
"""

import time
from collections.abc import Callable

import numpy as np

from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere

QUERIES = 100_000
REPEATS = 3


def surface() -> Mesh:
    """A bumpy sphere of 40,962 vertices."""
    ball = icosphere(6)
    x, y, z = ball.vertices.T
    radius = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.15 * z * x
    return Mesh(ball.vertices * radius[:, None], ball.faces, "bumpy")


def rate(work: Callable[[], object]) -> float:
    """Queries a second of processor time, the best of several runs."""
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return QUERIES / min(seconds)


def measure() -> list[dict[str, object]]:
    """Rates near the surface, where all stages but one ask, and all over a box."""
    mesh, generator = surface(), np.random.default_rng(0)
    tree = ClosestPointTree(mesh)
    picked = mesh.vertices[generator.integers(0, len(mesh.vertices), QUERIES)]
    near = picked + 0.05 * generator.standard_normal((QUERIES, 3))
    box = generator.uniform(-1.5, 1.5, (QUERIES, 3))
    tree.signed_distance(near[:10])  # builds the tree of the winding number
    rows = [
        ("closest points, near 40k vertices", rate(lambda: tree.query(near)), "≥ 80,000"),
        ("closest points, in the box of 40k vertices", rate(lambda: tree.query(box)), ""),
        ("signed distances, near 40k vertices", rate(lambda: tree.signed_distance(near)), ""),
    ]
    return [
        {"name": name, "figure": figure, "unit": "1/s", "required": required}
        for name, figure, required in rows
    ]


if __name__ == "__main__":
    for line in measure():
        print("{name:60s} {figure:10.0f} {unit} {required}".format(**line))  # noqa: T201
