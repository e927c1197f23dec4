"""Pictures for the loggers that take them; beside a table of numbers the files lie anyway."""

from pathlib import Path

import numpy as np
from lightning.pytorch.loggers import Logger, TensorBoardLogger, WandbLogger
from PIL import Image

# Pixels; sheets of many shapes are larger than a page of a logger shows.
_WIDTH = 1800


def log_pictures(logger: Logger, folder: Path) -> None:
    """Hand the pictures of a folder to wandb or TensorBoard, each under its file's name."""
    paths = sorted(folder.glob("*.png"))
    if isinstance(logger, WandbLogger):
        for path in paths:
            logger.log_image(f"pictures/{path.stem}", [_shown(path)])
    elif isinstance(logger, TensorBoardLogger):
        for path in paths:
            array = np.asarray(_shown(path))
            logger.experiment.add_image(f"pictures/{path.stem}", array, dataformats="HWC")


def _shown(path: Path) -> Image.Image:
    with Image.open(path) as opened:
        picture = opened.convert("RGB")
    picture.thumbnail((_WIDTH, 4 * _WIDTH))
    return picture
