"""Pictures of maps, and one page that shows a whole run offline."""

from gensp.pictures.draw import Drawn, PictureOptions, draw_all

__all__ = ["Drawn", "PictureOptions", "draw_all"]
