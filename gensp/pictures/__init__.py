"""Pictures of maps, and one page that shows a whole run offline.

The names below are loaded when they are first used: most of them need matplotlib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gensp.pictures.draw import Drawn as Drawn
    from gensp.pictures.draw import draw_all as draw_all
    from gensp.pictures.material import PictureOptions as PictureOptions

_HOMES = {"Drawn": "draw", "PictureOptions": "material", "draw_all": "draw"}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
