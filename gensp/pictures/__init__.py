"""Pictures of maps, and one page that shows a whole run offline."""

from gensp.pictures.draw import Drawn, draw_all
from gensp.pictures.material import PictureOptions

__all__ = ["Drawn", "PictureOptions", "draw_all"]
