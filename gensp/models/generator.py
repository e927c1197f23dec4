"""Shape generators g^θ: the sphere deformed to the shape of a code (paper §4.3–4.4)."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torchdiffeq import odeint

from gensp.errors import Unsupported
from gensp.models.latent_mlp import LatentMLP
from gensp.models.network import Network


class Generator(Network):
    """Base of the generators: codes are scaled by the spread of the shapes they stand for.

    Shapes of one collection crowd in latent space: they lie ten times farther from the sphere
    than from one another, so unscaled codes hardly tell them apart.
    """

    latent_scale: Tensor

    def __init__(self, settings: dict[str, Any]) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("latent_scale", torch.ones(()))

    @torch.no_grad()
    def fit_latent_scale(self, codes: Float[Tensor, "k d"], spread: float = 2.0) -> None:
        """Scale codes so that their root mean square distance from their mean is `spread`."""
        distance = (codes - codes.mean(dim=0)).square().sum(dim=1).mean().sqrt()
        if distance > 0:
            self.latent_scale.copy_(spread / distance)

    def scaled(self, z: Float[Tensor, "b d"]) -> Float[Tensor, "b d"]:
        """Codes as the network sees them; zero stays zero."""
        return z * self.latent_scale


class DirectGenerator(Generator):
    """The paper's generator: a plain network from (z, p) to a point.

    Parameters
    ----------
    latent
        Dimension of the code.
    layers
        Width, depth, inject, octaves and activation of the `LatentMLP`.
    """

    def __init__(self, latent: int, **layers: Any) -> None:
        super().__init__({"latent": latent, **layers})
        self.trunk = LatentMLP(latent, 3, 3, **layers)

    def forward(
        self, z: Float[Tensor, "b d"], p: Float[Tensor, "b n 3"]
    ) -> Float[Tensor, "b n 3"]:
        """Surface points of the sphere points p."""
        return self.trunk(self.scaled(z), p)


class AnchoredGenerator(Generator):
    """A generator that is exactly the identity of the sphere at z = 0.

    Parameters
    ----------
    latent
        Dimension of the code.
    form
        `difference`: g = p + h(z, p) − h(0, p). `linear`: g = p + W(z, p)·(A z), one evaluation.
    rank
        Number of rows of A, for `linear`.
    layers
        Width, depth, inject, octaves and activation of the `LatentMLP`.
    """

    def __init__(self, latent: int, *, form: str = "linear", rank: int = 8, **layers: Any) -> None:
        super().__init__({"latent": latent, "form": form, "rank": rank, **layers})
        if form not in ("difference", "linear"):
            raise Unsupported(
                f"anchored generator: form '{form}' is unknown; 'difference' or 'linear' is "
                "required; set model.generator.form"
            )
        self.form = form
        outputs = 3 * rank if form == "linear" else 3
        self.trunk = _starting_at_zero(LatentMLP(latent, 3, outputs, **layers))
        if form == "linear":
            self.mixing = nn.Linear(latent, rank, bias=False)

    def forward(
        self, z: Float[Tensor, "b d"], p: Float[Tensor, "b n 3"]
    ) -> Float[Tensor, "b n 3"]:
        """Surface points of the sphere points p."""
        z = self.scaled(z)
        if self.form == "linear":
            return p + _mix(self.trunk(z, p), self.mixing(z))
        # Bracketed: the difference is exactly zero at z = 0, the sum of three need not be p.
        return p + (self.trunk(z, p) - self.trunk(torch.zeros_like(z), p))


class FlowGenerator(Generator):
    """Sphere points carried along a velocity field for unit time.

    The velocity W(x, z, t)·(A z) vanishes at z = 0, and its flow cannot fold up to the error of
    the solver. Fixed steps of a Runge–Kutta method are differentiable in forward mode, which
    adaptive and adjoint solvers are not.

    Parameters
    ----------
    latent
        Dimension of the code.
    rank
        Number of rows of A.
    steps
        Runge–Kutta steps.
    layers
        Width, depth, inject, octaves and activation of the `LatentMLP`.
    """

    def __init__(self, latent: int, *, rank: int = 8, steps: int = 4, **layers: Any) -> None:
        super().__init__({"latent": latent, "rank": rank, "steps": steps, **layers})
        self.steps = steps
        self.trunk = _starting_at_zero(LatentMLP(latent, 4, 3 * rank, **layers))
        self.mixing = nn.Linear(latent, rank, bias=False)

    def forward(
        self, z: Float[Tensor, "b d"], p: Float[Tensor, "b n 3"]
    ) -> Float[Tensor, "b n 3"]:
        """Surface points of the sphere points p."""
        z = self.scaled(z)
        mixed = self.mixing(z)

        def velocity(t: Tensor, x: Tensor) -> Tensor:
            time = t.to(x.dtype).expand(*x.shape[:2], 1)
            return _mix(self.trunk(z, torch.cat([x, time], dim=2)), mixed)

        ends = torch.tensor([0.0, 1.0], dtype=p.dtype, device=p.device)
        options = {"step_size": 1 / self.steps}
        path: Tensor = odeint(velocity, p, ends, method="rk4", options=options)
        return path[-1]


def _starting_at_zero(trunk: LatentMLP) -> LatentMLP:
    """Untrained, the generator is the sphere for every code, however far it was scaled."""
    nn.init.zeros_(trunk.last.weight)
    nn.init.zeros_(trunk.last.bias)
    return trunk


def _mix(weights: Float[Tensor, "b n _"], mixed: Float[Tensor, "b r"]) -> Float[Tensor, "b n 3"]:
    """W·(A z) for every point, W given as rows of 3r numbers."""
    matrices = weights.reshape(*weights.shape[:2], 3, mixed.shape[1])
    return (matrices * mixed[:, None, None]).sum(dim=3)


def tangent_frame(p: Float[Tensor, "b n 3"]) -> Float[Tensor, "b n 3 2"]:
    """Two orthonormal tangents at unit vectors, the same as `geometry.sphere.tangent_frame`."""
    axis = torch.zeros_like(p)
    steep = p[..., :1].abs() < 0.8
    axis[..., :1] = steep.to(p.dtype)
    axis[..., 1:2] = (~steep).to(p.dtype)
    first = axis - (axis * p).sum(dim=2, keepdim=True) * p
    first = first / first.norm(dim=2, keepdim=True)
    return torch.stack([first, torch.linalg.cross(p, first)], dim=3)


def jacobian(
    generator: Callable[[Tensor, Tensor], Tensor],
    z: Float[Tensor, "b d"],
    p: Float[Tensor, "b n 3"],
) -> Float[Tensor, "b n 3 2"]:
    """J_p = ∂g/∂p in the tangent frame of every sphere point (paper §4.4), by forward mode."""
    frame = tangent_frame(p)

    def push(tangent: Tensor) -> Tensor:
        return torch.func.jvp(lambda q: generator(z, q), (p,), (tangent,))[1]

    # Mapped over the tangents, the values themselves are computed once.
    columns: Tensor = torch.func.vmap(push, in_dims=3, out_dims=3)(frame)
    return columns
