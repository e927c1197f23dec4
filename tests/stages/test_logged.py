"""What the loggers are handed besides numbers."""

from pathlib import Path

import numpy as np
import pytest
from commands import smoke_words, train
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from gensp.files import read_json, read_rows
from gensp.stages.logged import log_pictures


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A wide picture, a small one, and one of a single shape."""
    folder = tmp_path / "pictures"
    (folder / "shapes").mkdir(parents=True)
    for name, width in {"sheet": 3600, "latents": 40, "shapes/one": 10}.items():
        Image.fromarray(np.full((20, width, 3), 90, np.uint8)).save(folder / f"{name}.png")
    return folder


def images(folder: Path) -> dict[str, tuple[int, int]]:
    """Width and height of the last picture under every name of TensorBoard's."""
    found = EventAccumulator(str(folder)).Reload()
    last = {tag: found.Images(tag)[-1] for tag in found.Tags()["images"]}
    return {tag: (image.width, image.height) for tag, image in last.items()}


def test_tensorboard_shows_the_sheets(pictures: Path, tmp_path: Path) -> None:
    logger = TensorBoardLogger(str(tmp_path), name="logs", version="")
    log_pictures(logger, pictures)
    logger.finalize("success")
    assert images(tmp_path / "logs") == {
        "pictures/sheet": (1800, 10),
        "pictures/latents": (40, 20),
    }


def test_a_table_of_numbers_is_left_alone(pictures: Path, tmp_path: Path) -> None:
    log_pictures(CSVLogger(str(tmp_path), name="logs", version=""), pictures)
    assert not (tmp_path / "logs").exists()


@pytest.mark.slow
def test_an_evaluation_logs_its_pictures_to_tensorboard(smoke_copy: Path) -> None:
    words = smoke_words(smoke_copy)
    train(*words, "stage=evaluate", "logger=tensorboard", "force=true", "workers.jobs=1")
    shown = images(smoke_copy / "smoke" / "full" / "evaluate" / "logs")
    names = {"contact_sheet", "latents", "morphs", "worst", "distortion", "losses", "flows"}
    assert {f"pictures/{name}" for name in names} <= shown.keys()


@pytest.mark.slow
def test_wandb_without_network_keeps_the_pictures_and_spoils_no_seal(smoke_copy: Path) -> None:
    words = [*smoke_words(smoke_copy), "logger=wandb_offline", "force=true", "workers.jobs=1"]
    variant = smoke_copy / "smoke" / "full"
    before = read_json(variant / "evaluate" / "manifest.json")
    train(*words, "stage=initialize", "recipe.initialize.epochs=1")
    # What wandb goes on writing belongs to no result: the next stage reads this one.
    train(*words, "stage=finetune", "recipe.finetune.epochs=1")
    rows = read_rows(variant / "finetune" / "history.csv")
    assert float(rows[-1]["val/sigma"]) > 1
    train(*words, "stage=evaluate")
    kept = {path.name.split("_")[0] for path in (variant / "evaluate").rglob("media/**/*.png")}
    assert {"contact", "latents", "morphs", "worst", "distortion", "losses"} <= kept
    assert list((variant / "evaluate" / "wandb").glob("offline-run-*/*.wandb"))
    after = read_json(variant / "evaluate" / "manifest.json")
    assert after["digest"] == before["digest"]
