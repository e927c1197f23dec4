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
    mean_code: Tensor
    mean_image: Tensor

    def __init__(self, settings: dict[str, Any]) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("latent_scale", torch.ones(()))
        # Of the shapes learnt from: their mean code and the mean image of an icosphere's vertices.
        self.register_buffer("mean_code", torch.zeros(settings["latent"]))
        self.register_buffer("mean_image", torch.zeros((0, 3)))

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *rest: Any, **named: Any
    ) -> None:
        # Only the weights know of which icosphere the image is.
        if f"{prefix}mean_image" in state_dict:
            image = state_dict[f"{prefix}mean_image"]
            self.mean_image = self.mean_image.new_zeros(image.shape)
        super()._load_from_state_dict(state_dict, prefix, *rest, **named)

    @torch.no_grad()
    def fit_latents(self, codes: Float[Tensor, "k d"], spread: float = 2.0) -> None:
        """Scale codes to lie `spread` from their mean, as root mean square; before training."""
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


class MixingGenerator(Generator):
    """Base of the generators that move points by W·(A z), and so not at all at z = 0."""

    def __init__(self, settings: dict[str, Any], latent: int, rank: int) -> None:
        super().__init__(settings)
        self.mixing = nn.Linear(latent, rank, bias=False)

    @torch.no_grad()
    def fit_latents(self, codes: Float[Tensor, "k d"], spread: float = 2.0) -> None:
        """Scale codes; let A begin with their mean, then their principal axes around it.

        The first entry of A z is how far from the sphere a shape lies, about 1 for those given.
        """
        super().fit_latents(codes, spread)
        codes = self.scaled(codes)
        mean = codes.mean(dim=0)
        if not mean.any():
            return
        away = codes - codes @ mean[:, None] * mean / mean.square().sum()
        away = away - away.mean(dim=0)
        axes = torch.linalg.svd(away, full_matrices=False)[2][: self.mixing.out_features - 1]
        self.mixing.weight.zero_()
        self.mixing.weight[0] = mean / mean.square().sum()
        self.mixing.weight[1 : 1 + len(axes)] = axes


class AnchoredGenerator(MixingGenerator):
    """A generator that is exactly the identity of the sphere at z = 0.

    Parameters
    ----------
    latent
        Dimension of the code.
    form
        `blend`: g = p + W(a, p)·(A z), where W sees of the code only the first entry a of A z,
        how far the shape is from the sphere; for collections too small to learn more.
        `linear`: g = p + W(z, p)·(A z). `difference`: g = p + h(z, p) − h(0, p), twice the cost.
    rank
        Number of rows of A, for `blend` and `linear`.
    layers
        Width, depth, inject, octaves and activation of the `LatentMLP`.
    """

    def __init__(self, latent: int, *, form: str = "linear", rank: int = 8, **layers: Any) -> None:
        super().__init__({"latent": latent, "form": form, "rank": rank, **layers}, latent, rank)
        if form not in ("blend", "linear", "difference"):
            raise Unsupported(
                f"anchored generator: form '{form}' is unknown; 'blend', 'linear' or 'difference' "
                "is required; set recipe.model.generator.form"
            )
        self.form = form
        seen = 1 if form == "blend" else latent
        outputs = 3 if form == "difference" else 3 * rank
        self.trunk = _starting_at_zero(LatentMLP(seen, 3, outputs, **layers))
        self.mixing.requires_grad_(form != "difference")

    def forward(
        self, z: Float[Tensor, "b d"], p: Float[Tensor, "b n 3"]
    ) -> Float[Tensor, "b n 3"]:
        """Surface points of the sphere points p."""
        z = self.scaled(z)
        if self.form != "difference":
            mixed = self.mixing(z)
            seen = mixed[:, :1] if self.form == "blend" else z
            return p + _mix(self.trunk(seen, p), mixed)
        # Bracketed: the difference is exactly zero at z = 0, the sum of three need not be p.
        return p + (self.trunk(z, p) - self.trunk(torch.zeros_like(z), p))


class FlowGenerator(MixingGenerator):
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
        settings = {"latent": latent, "rank": rank, "steps": steps, **layers}
        super().__init__(settings, latent, rank)
        self.steps = steps
        self.trunk = _starting_at_zero(LatentMLP(latent, 4, 3 * rank, **layers))

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
