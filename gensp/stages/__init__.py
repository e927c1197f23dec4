"""The seven stages and what prepares for them; each is loaded when it is named."""

from importlib import import_module
from typing import Any

_HOMES = {
    "PrepareStage": "prepare",
    "AugmentStage": "augment",
    "ImplicitStage": "implicit",
    "CorrespondStage": "correspond",
    "PairedStage": "pairing",
    "InitializeStage": "generator",
    "FinetuneStage": "generator",
    "ParameterizeStage": "parameterize",
    "EvaluateStage": "evaluate",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
