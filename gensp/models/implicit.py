"""Implicit shape generator f^φ: a signed distance for every code and point (paper §4.2)."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gensp.models.latent_mlp import LatentMLP
from gensp.models.network import Network


@dataclass(frozen=True)
class FieldGradients:
    """Value (b, n) of the field and its gradients in x (b, n, 3) and in z (b, n, d)."""

    value: Float[Tensor, "b n"]
    x: Float[Tensor, "b n 3"]
    z: Float[Tensor, "b n d"]


class ImplicitField(Network):
    """Signed distance f(z, x), negative inside.

    Parameters
    ----------
    latent
        Dimension of the code.
    sphere_residual
        Learn the difference to the unit sphere, f = ‖x‖ − 1 + h(z, x), instead of f itself.
    layers
        Width, depth, inject, octaves and activation of the `LatentMLP`.
    """

    def __init__(self, latent: int, *, sphere_residual: bool = True, **layers: Any) -> None:
        super().__init__()
        self.settings = {"latent": latent, "sphere_residual": sphere_residual, **layers}
        self.trunk = LatentMLP(latent, 3, 1, **layers)
        self.sphere_residual = sphere_residual

    def forward(self, z: Float[Tensor, "b d"], x: Float[Tensor, "b n 3"]) -> Float[Tensor, "b n"]:
        """Signed distance at every point of every shape."""
        value: Tensor = self.trunk(z, x).squeeze(2)
        if self.sphere_residual:
            # The small number makes the norm differentiable, twice, at the centre too.
            value = value + (x.square().sum(dim=2) + 1e-12).sqrt() - 1
        return value

    def rowwise(self, x: Float[Tensor, "m 3"], z: Float[Tensor, "m d"]) -> Float[Tensor, " m"]:
        """Signed distance with a code of its own for every point."""
        value: Tensor = self(z, x[:, None]).squeeze(1)
        return value

    def gradients(self, z: Float[Tensor, "b d"], x: Float[Tensor, "b n 3"]) -> FieldGradients:
        """Value and both gradients at every point, differentiable in the parameters.

        One reverse pass: every point gets a copy of its shape's code.
        """
        batch, count, _ = x.shape
        codes = z[:, None].expand(-1, count, -1).reshape(batch * count, -1)
        points = x.reshape(batch * count, 3)
        codes, points = (
            v if v.requires_grad else v.detach().requires_grad_() for v in (codes, points)
        )
        value = self.rowwise(points, codes)
        in_x, in_z = torch.autograd.grad(value.sum(), (points, codes), create_graph=True)
        return FieldGradients(
            value.reshape(batch, count),
            in_x.reshape(batch, count, 3),
            in_z.reshape(batch, count, -1),
        )
