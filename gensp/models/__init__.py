"""Networks: the encoder e^γ, the implicit field f^φ and the generators g^θ."""

from gensp.models.encoder import Grouping, PointNet2Encoder
from gensp.models.generator import (
    AnchoredGenerator,
    DirectGenerator,
    FlowGenerator,
    Generator,
    jacobian,
)
from gensp.models.implicit import ImplicitField
from gensp.models.latent_mlp import LatentMLP
from gensp.models.store import load_model, save_model

__all__ = [
    "AnchoredGenerator",
    "DirectGenerator",
    "FlowGenerator",
    "Generator",
    "Grouping",
    "ImplicitField",
    "LatentMLP",
    "PointNet2Encoder",
    "jacobian",
    "load_model",
    "save_model",
]
