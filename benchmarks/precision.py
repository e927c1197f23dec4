"""How far bf16-mixed and compile=true move the gradient of every loss, on small random networks.

OMP_NUM_THREADS=1 python benchmarks/precision.py      # minutes, nearly all of the C++ compiler
OMP_NUM_THREADS=1 python benchmarks/precision.py --timed quick --out precision

Printed is ‖g − g₀‖ / ‖g₀‖ of all weights' gradients g, where g₀ is that in single precision,
uncompiled: the largest of some draws of weights and data. bf16-mixed covers the whole loss,
Eqs. 5 and 12 too, which trainings keep out of it. Losses of derivatives are not
compiled: PyTorch refuses them (`tests/stages/test_speed.py`). `--timed` prints instead what an
optimiser step of a recipe's trainings takes with either word, in processor seconds of one thread,
without Eqs. 5 and 12, which neither word touches.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from rich.console import Console
from torch import Tensor, nn
from training_costs import PLAIN, TRAININGS, Bench

from gensp.geometry.reduced import deformation_cover
from gensp.geometry.sphere import icosphere
from gensp.losses import (
    correspondence_loss,
    generator_deformation,
    implicit_deformation,
    sdf_loss,
)
from gensp.models import (
    AnchoredGenerator,
    FlowGenerator,
    ImplicitField,
    PointNet2Encoder,
    jacobian,
)
from gensp.stages.speed import compiled_call

LATENT, SHAPES, POINTS = 8, 4, 256
SMALL = {"width": 48, "depth": 3}
BALL = torch.tensor(icosphere(2).vertices, dtype=torch.float32)
Call = Callable[..., Tensor]
# A loss of networks, these networks, and which of them are compiled.
Case = tuple[Callable[..., Tensor], list[nn.Module], list[bool]]


def field_case() -> Case:
    """Eq. 3 of the field at given codes."""
    z, x = torch.randn(SHAPES, LATENT), torch.randn(SHAPES, POINTS, 3)
    distance = x.norm(dim=2) - 0.8
    return lambda f: sdf_loss(f(z, x), distance), [field()], [True]


def encoded_case(compiled: list[bool]) -> Case:
    """Eq. 3 of the field at the encoder's codes of random clouds."""
    clouds, x = torch.randn(SHAPES, 128, 3), torch.randn(SHAPES, POINTS, 3)
    distance = x.norm(dim=2) - 0.8
    encoder = PointNet2Encoder(LATENT, width=8, groups=((32, 8), (8, 4)))
    grouping = encoder.group(clouds)
    return (
        lambda f, e: sdf_loss(f(e(clouds, grouping), x), distance),
        [field(), encoder],
        compiled,
    )


def blend_case() -> Case:
    """Eq. 10 of the blend generator."""
    z, p = torch.randn(SHAPES, LATENT), BALL.expand(SHAPES, -1, -1)
    targets, valid = p + 0.3 * torch.randn(p.shape), torch.ones(p.shape[:2], dtype=torch.bool)
    generator = AnchoredGenerator(LATENT, form="blend", rank=4, inject=(), **SMALL)
    return lambda g: correspondence_loss(g(z, p), targets, valid), [generator], [True]


def level_set_case() -> Case:
    """Eq. 5 on the unit sphere."""
    cover, directions = deformation_cover(BALL, 15), torch.eye(LATENT)[:2]

    def loss(f: Call) -> Tensor:
        def rowwise(x: Tensor, z: Tensor) -> Tensor:
            return f(z, x[:, None]).squeeze(1)

        return implicit_deformation(rowwise, torch.zeros(LATENT), BALL, cover, directions, 0.1)

    return loss, [field()], [False]


def flow_case() -> Case:
    """Eq. 12 of the flow generator."""
    z, p = torch.randn(SHAPES, LATENT), BALL[:64].repeat(SHAPES, 1, 1)
    generator = FlowGenerator(LATENT, rank=4, steps=2, inject=(), **SMALL)
    # It begins as the identity, where Eq. 12 has its minimum and its gradient is zero.
    with torch.no_grad():
        for weight in generator.parameters():
            weight += 0.1 * torch.randn(weight.shape)
    return lambda g: generator_deformation(jacobian(g, z, p), 0.01), [generator], [False]


def field() -> ImplicitField:
    """A small one."""
    return ImplicitField(LATENT, inject=(2,), **SMALL)


CASES: dict[str, Callable[[], Case]] = {
    "Eq. 3, field": field_case,
    "Eq. 3, field and encoder, field compiled": lambda: encoded_case([True, False]),
    "Eq. 3, field and encoder, both compiled": lambda: encoded_case([True, True]),
    "Eq. 10, blend generator": blend_case,
    "Eq. 5, field": level_set_case,
    "Eq. 12, flow generator": flow_case,
}


def gradient(
    loss: Call, networks: Sequence[nn.Module], calls: Sequence[Call], mixed: bool = False
) -> Tensor:
    """That of all weights, one after another, where the loss calls the networks by `calls`."""
    weights = [weight for network in networks for weight in network.parameters()]
    with torch.autocast("cpu", torch.bfloat16, enabled=mixed):
        value = loss(*calls)
    found = torch.autograd.grad(value.float(), weights, allow_unused=True)
    return torch.cat([part.flatten() for part in found if part is not None])


def deviations(make: Callable[[], Case], draws: int) -> tuple[float, float]:
    """The largest over some draws of networks and data: of bf16-mixed, of compile=true."""
    _, networks, which = make()
    calls = [
        compiled_call(network) if chosen else network
        for network, chosen in zip(networks, which, strict=True)
    ]
    mixed, compiled = [], []
    for seed in range(draws):
        torch.manual_seed(seed)
        loss, drawn, _ = make()
        for network, other in zip(networks, drawn, strict=True):
            network.load_state_dict(other.state_dict())
        plain = gradient(loss, networks, networks)
        away = gradient(loss, networks, networks, mixed=True) - plain
        mixed.append(float(away.norm() / plain.norm()))
        away = gradient(loss, networks, calls) - plain
        compiled.append(float(away.norm() / plain.norm()))
    return max(mixed), max(compiled)


def show_steps(console: Console, recipe: str, out: Path) -> None:
    """A line for every training: seconds of a step, plain and with either word."""
    torch.set_num_threads(1)
    bench = Bench(out, recipe, steps=4, counting=False)
    numbers = bench.configured("implicit").recipe
    bench.prepare(max(numbers[stage].batch for stage in TRAININGS) - 1)
    console.print(
        "| training | plain (s) | bf16-mixed (s) | compile=true (s) |\n|---|---|---|---|"
    )
    for stage in TRAININGS:
        words = ("compile=false", "trainer.precision=bf16-mixed", "compile=true")
        costs = [bench.cost(stage, PLAIN, word).seconds for word in words]
        cells = " | ".join(f"{seconds:.3g}" for seconds in costs)
        console.print(f"| {stage}, recipe={recipe} | {cells} |", markup=False)


def show_deviations(console: Console, draws: int) -> None:
    """A line for every loss: by how much either word moves its gradient."""
    console.print("| loss | bf16-mixed | compile=true | seconds |\n|---|---|---|---|")
    for name, make in CASES.items():
        began = time.perf_counter()
        mixed, compiled = deviations(make, draws)
        shown = f"{compiled:.0e}" if any(make()[2]) else ""
        seconds = f"{time.perf_counter() - began:.0f}"
        line = " | ".join([name, f"{mixed:.1%}", shown, seconds])
        console.print(f"| {line} |", markup=False)


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--timed", metavar="RECIPE", help="time steps of its trainings instead")
    parser.add_argument("--out", type=Path, default=Path("precision"), help="of --timed")
    given = parser.parse_args()
    console = Console(file=sys.stdout, soft_wrap=True, highlight=False)
    if given.timed:
        show_steps(console, given.timed, given.out.resolve())
    else:
        show_deviations(console, given.draws)


if __name__ == "__main__":
    main()
