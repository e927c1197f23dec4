"""Consistent spherical parameterization of genus-0 shape collections.

The names below are loaded when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gensp.api import load as load
    from gensp.api import parameterize as parameterize
    from gensp.api import spherical_map as spherical_map
    from gensp.geometry.mesh import Mesh as Mesh
    from gensp.geometry.mesh import load_mesh as load_mesh
    from gensp.geometry.mesh import save_mesh as save_mesh
    from gensp.geometry.spherical_map import SphericalMap as SphericalMap
    from gensp.geometry.spherical_map import load_map as load_map
    from gensp.geometry.spherical_map import save_map as save_map
    from gensp.methods.cmcf import CMCF as CMCF
    from gensp.methods.gensp import GenSP as GenSP

__version__ = "0.1.0"

_HOMES = {
    "load": "api",
    "parameterize": "api",
    "spherical_map": "api",
    "Mesh": "geometry.mesh",
    "load_mesh": "geometry.mesh",
    "save_mesh": "geometry.mesh",
    "SphericalMap": "geometry.spherical_map",
    "load_map": "geometry.spherical_map",
    "save_map": "geometry.spherical_map",
    "CMCF": "methods.cmcf",
    "GenSP": "methods.gensp",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
