"""The textured GLB, drawn by a browser: every pixel has the colour of its place on the sphere."""

import base64
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gensp.export.textured import write_textured
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_map import SphericalMap
from gensp.geometry.texture_coordinates import equirectangular_directions

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WORDS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--force-device-scale-factor=1", "--force-color-profile=srgb",
    "--hide-scrollbars", "--window-size=1000,600", "--virtual-time-budget=15000",
)  # fmt: skip
SIZE = 300  # pixels of one side, as in glb.html
# Axes to the right, up, and towards the eye: the seam, the north pole, the south pole in front.
SIDES = np.array(
    [
        [[0.0, 1, 0], [0, 0, 1], [1, 0, 0]],
        [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1.0, 0, 0], [0, -1, 0], [0, 0, -1]],
    ]
)


@pytest.fixture
def browser() -> str:
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"none of {', '.join(NAMES)} is on the PATH, and gensp needs no browser")
    return found


@pytest.fixture
def textured(tmp_path: Path) -> Path:
    """A ball whose poles lie within triangles, red by x, green by y, blue by z."""
    ball = icosphere(3)
    turned = ball.vertices @ Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix().T
    colours = np.round(colour_of(equirectangular_directions(256))).astype(np.uint8)
    return write_textured(SphericalMap(turned, turned, ball.faces), colours, tmp_path / "ball")[0]


def colour_of(p: np.ndarray) -> np.ndarray:
    return 127.5 * (1 + p)


def photographed(browser: str, glb: Path) -> np.ndarray:
    """What the browser shows of a GLB, from every side (k, SIZE, SIZE, 3)."""
    text = Path(__file__).with_name("glb.html").read_text(encoding="utf-8")
    text = text.replace("{{glb}}", base64.b64encode(glb.read_bytes()).decode())
    page, shot = glb.with_suffix(".html"), glb.with_suffix(".shot.png")
    page.write_text(text.replace("{{sides}}", json.dumps(SIDES.tolist())), encoding="utf-8")
    profile = f"--user-data-dir={glb.parent / 'profile'}"
    words = [browser, *WORDS, profile, f"--screenshot={shot}", page.as_uri()]
    subprocess.run(words, check=True, capture_output=True, timeout=120)
    row = np.asarray(Image.open(shot).convert("RGB"))[:SIZE, : len(SIDES) * SIZE]
    return np.stack(np.split(row.astype(float), len(SIDES), axis=1))


def test_a_browser_shows_neither_seam_nor_poles(browser: str, textured: Path) -> None:
    x, y = np.meshgrid(*2 * [(2 * np.arange(SIZE) + 1) / SIZE - 1])
    squared = x**2 + y**2
    front = np.stack([x, -y, np.sqrt(np.maximum(1 - squared, 0))], axis=-1)
    for rows, seen in zip(SIDES, photographed(browser, textured), strict=True):
        assert (seen[squared > 1.02] == 255).all()
        away = np.abs(seen - colour_of(unit(front @ rows)))
        # Triangles are flat, and linear in longitude and latitude: a few of 255 steps.
        assert away[squared < 0.9].max() < 5
