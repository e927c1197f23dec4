"""Eq. 7 at the paper's size (m = 2000, l = 200, float64): elimination against the dense saddle.

    python benchmarks/regularizer.py

The dense system has 8,000 unknowns: about 2 GiB and a minute of one core.
"""

import argparse
import time
from collections.abc import Callable

import torch
from torch import Tensor

from gensp.geometry.levelset import extract_surface, level_set_velocity, relative_deformation
from gensp.geometry.reduced import Cover, deformation_cover, reduced_quadratic

VERTICES, NODES, DIRECTIONS = 2000, 200, 4
SCALE_WEIGHT = 0.1


def bumpy_family(x: Tensor, z: Tensor) -> Tensor:
    """A smooth family of implicit surfaces without symmetry, f(x (m, 3), z (m, 4)) -> (m,)."""
    axes = x.new_tensor([1.4, 1.0, 0.7])
    waves = x.new_tensor([[2.0, 0.5, -1.0, 0.0], [0.0, 3.0, 1.0, 1.0], [1.0, 0.0, 2.0, -2.0]])
    return (x / axes).norm(dim=1) - 1 - 0.1 * torch.sin(x @ waves + z).sum(dim=1)


def timed(call: Callable[[], Tensor]) -> tuple[Tensor, float]:
    """Result and seconds."""
    start = time.perf_counter()
    result = call()
    return result, time.perf_counter() - start


def dense_saddle(grad_x: Tensor, forcing: Tensor, points: Tensor, cover: Cover) -> Tensor:
    """Displacements (k, m, 3) by LU of the 4m × 4m saddle matrix, ridge-free."""
    m = len(points)
    rows = torch.arange(m)[:, None]
    saddle = points.new_zeros(4 * m, 4 * m)
    saddle[: 3 * m, : 3 * m] = reduced_quadratic(points, cover, scale_weight=SCALE_WEIGHT)
    saddle[3 * m + rows, 3 * rows + torch.arange(3)] = grad_x
    saddle[3 * rows + torch.arange(3), 3 * m + rows] = grad_x
    right = torch.cat([points.new_zeros(3 * m, forcing.shape[1]), -forcing])
    return torch.linalg.solve(saddle, right)[: 3 * m].T.reshape(-1, m, 3)


def measure() -> list[dict[str, object]]:
    """Seconds of both routes, their ratio, their largest disagreement, seconds of a backward."""
    surface = extract_surface(
        lambda x: bumpy_family(x, x.new_zeros(1, 4)),
        resolution=64,
        vertices=VERTICES,
        bounds=2.0,
        dtype=torch.float64,
    )
    points = torch.tensor(surface.vertices, requires_grad=True)
    codes = torch.zeros(len(points), 4, dtype=torch.float64, requires_grad=True)
    value = bumpy_family(points, codes).sum()
    grad_x, grad_z = (g.detach() for g in torch.autograd.grad(value, (points, codes)))
    points, cover = points.detach(), deformation_cover(points.detach(), NODES)
    directions = torch.randn(DIRECTIONS, 4, dtype=torch.float64, generator=torch.manual_seed(0))
    grad_x.requires_grad_()

    def eliminated() -> Tensor:
        velocity = level_set_velocity(
            grad_x, grad_z, points, cover, directions, scale_weight=SCALE_WEIGHT, ridge=0.0
        )
        return torch.cat([velocity.displacements.flatten(), relative_deformation(velocity)])

    eliminated()  # the first call loads libraries
    result, seconds = timed(eliminated)
    _, backward = timed(lambda: torch.autograd.grad(result[-DIRECTIONS:].mean(), grad_x)[0])
    forcing = grad_z @ directions.T
    expected, dense = timed(lambda: dense_saddle(grad_x.detach(), forcing, points, cover))
    difference = (result.detach()[:-DIRECTIONS].reshape(expected.shape) - expected).abs().max()
    return [
        row("regulariser: elimination", seconds, "s"),
        row("regulariser: backward", backward, "s"),
        row("regulariser: dense saddle LU", dense, "s"),
        row("regulariser: speed-up", dense / seconds, "×", "≥ 50"),
        row("regulariser: disagreement", float(difference / expected.abs().max()), "", "≤ 1e-8"),
    ]


def row(name: str, figure: float, unit: str, required: str = "") -> dict[str, object]:
    """One line of the benchmark table."""
    return {"name": name, "figure": figure, "unit": unit, "required": required}


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    for line in measure():
        print("{name:32s} {figure:12.3g} {unit:2s} {required}".format(**line))  # noqa: T201
