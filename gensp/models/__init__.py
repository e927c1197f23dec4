"""Networks: encoder e^γ, implicit field f^φ, generators g^θ; and what a model keeps beside."""

from gensp.models.atlas import Atlas
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
    "Atlas",
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
