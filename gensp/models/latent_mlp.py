"""The trunk shared by the implicit field and the generators.

Source: paper appendix B.5; Park et al., DeepSDF, CVPR 2019.
"""

import math
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "silu": functional.silu,
    "relu": functional.relu,
    "softplus": functional.softplus,
}


class LatentLinear(nn.Module):
    """A linear layer on (z, x) whose latent part is computed once per shape, not per point."""

    def __init__(self, latent: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.latent = latent
        self.weight = nn.Parameter(torch.empty(outputs, latent + inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.kaiming_normal_(self.weight, nonlinearity="relu")

    def forward(
        self, z: Float[Tensor, "b d"], x: Float[Tensor, "b n i"]
    ) -> Float[Tensor, "b n o"]:
        """The layer applied to z joined to every row of x."""
        of_shape = functional.linear(z, self.weight[:, : self.latent], self.bias)
        return functional.linear(x, self.weight[:, self.latent :]) + of_shape[:, None]


class LatentMLP(nn.Module):
    """Fully connected network on points, conditioned on a latent code.

    Parameters
    ----------
    latent, inputs, outputs
        Dimensions of the code, of a point and of the answer.
    width, depth
        Units in a hidden layer and number of hidden layers.
    inject
        Hidden layers, counted from 1, that see the code and the point again; the first always
        does.
    octaves
        Sines and cosines of the point at frequencies π/2, π, 2π, ... beside the point itself.
    activation
        `silu` (smooth, cheap), `relu` or `softplus`.
    """

    def __init__(
        self,
        latent: int,
        inputs: int,
        outputs: int,
        width: int = 1024,
        depth: int = 10,
        inject: Sequence[int] = (3, 6),
        octaves: int = 0,
        activation: str = "silu",
    ) -> None:
        super().__init__()
        self.inject = {1, *inject}
        self.octaves = octaves
        self.activation = ACTIVATIONS[activation]
        point = inputs * (1 + 2 * octaves)
        self.hidden = nn.ModuleList(
            LatentLinear(latent, point + width * (k > 1), width)
            if k in self.inject
            else _hidden_layer(width)
            for k in range(1, depth + 1)
        )
        self.last = nn.Linear(width, outputs)

    def forward(
        self, z: Float[Tensor, "b d"], x: Float[Tensor, "b n i"]
    ) -> Float[Tensor, "b n o"]:
        """Answer at every point x of every shape z."""
        x = self._encoded(x)
        h = x
        layer: nn.Module
        for k, layer in enumerate(self.hidden, start=1):
            if k == 1:
                h = layer(z, x)
            elif k in self.inject:
                h = layer(z, torch.cat([x, h], dim=2))
            else:
                h = layer(h)
            h = self.activation(h)
        answer: Tensor = self.last(h)
        return answer

    def _encoded(self, x: Float[Tensor, "b n i"]) -> Float[Tensor, "b n _"]:
        if self.octaves == 0:
            return x
        frequencies = math.pi / 2 * 2.0 ** torch.arange(self.octaves, dtype=x.dtype)
        angles = (x[..., None] * frequencies.to(x.device)).flatten(2)
        return torch.cat([x, angles.sin(), angles.cos()], dim=2)


def _hidden_layer(width: int) -> nn.Linear:
    """A layer that keeps the variance; PyTorch's default loses the code within ten layers."""
    layer = nn.Linear(width, width)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    nn.init.zeros_(layer.bias)
    return layer
