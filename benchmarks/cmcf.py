"""Mean curvature flow: 100 steps at 10,000 vertices on one core, and its sparse solves.

python benchmarks/cmcf.py
"""

import time
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from gensp.geometry.flow import StepSchedule, cmcf
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import adjacency, cotangent_laplacian, lumped_mass
from gensp.geometry.sphere import icosphere

STEPS = 100
NEWTON_LEVEL = 6  # 40,962 vertices, two unknowns each


def bumpy(level: int) -> Mesh:
    """A star-shaped surface without symmetry."""
    ball = icosphere(level)
    x, y, z = ball.vertices.T
    radius = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.15 * z * x
    return Mesh(ball.vertices * radius[:, None], ball.faces)


def best_of(call: Callable[[], object], repeats: int = 3) -> float:
    """Least processor seconds."""
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        taken.append(time.process_time() - start)
    return min(taken)


def flow_of_all_steps() -> None:
    """Steps too small to arrive, so that none is saved by stopping early."""
    flow = cmcf(bumpy(5), step=StepSchedule(0.002, 1.0, 0.002), max_steps=STEPS, tolerance=0.0)
    if len(flow.times) != STEPS + 1:
        raise RuntimeError(f"the flow ended after {len(flow.times) - 1} of {STEPS} steps")


def newton_pattern() -> tuple[sp.csc_matrix, np.ndarray]:
    """A definite matrix with 2×2 blocks on the edges, and the vertices that it sits at."""
    mesh = bumpy(NEWTON_LEVEL)
    matrix = sp.kron(-adjacency(mesh.faces), np.ones((2, 2)))
    degree = np.asarray(-matrix.sum(axis=1)).reshape(-1)
    return sp.csc_matrix(matrix + sp.diags(degree + 1)), mesh.vertices


def measure() -> list[dict[str, object]]:
    """Seconds of the flow and of factoring a Laplacian and a Newton matrix again."""
    mesh = bumpy(5)
    mass = sp.diags(lumped_mass(mesh.vertices, mesh.faces))
    heat = sp.csc_matrix(mass + 0.1 * cotangent_laplacian(mesh))
    small, (newton, points) = SPDSolver(heat, mesh.vertices), newton_pattern()
    large = SPDSolver(newton, points)
    flow = best_of(flow_of_all_steps, 1)
    return [
        row(f"CMCF: {STEPS} steps, {len(mesh.vertices)} vertices", flow, "≤ 10"),
        row("sparse: Laplacian factored again", best_of(lambda: small.refactor(heat))),
        row(
            f"sparse: Newton matrix, {newton.shape[0]} unknowns, factored again",
            best_of(lambda: large.refactor(newton)),
        ),
    ]


def row(name: str, seconds: float, required: str = "") -> dict[str, object]:
    """One line of the benchmark table."""
    return {"name": name, "figure": seconds, "unit": "s", "required": required}


if __name__ == "__main__":
    for line in measure():
        print("{name:60s} {figure:8.3g} {unit:2s} {required}".format(**line))  # noqa: T201
