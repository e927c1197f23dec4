"""The octahedral map, geometry images, and their files."""

import json
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from gensp.errors import Unsupported
from gensp.export.images import png_bytes, write_geometry_image
from gensp.geometry.octahedral import (
    geometry_image,
    octahedral_coordinates,
    octahedral_directions,
    octahedral_grid,
)
from gensp.geometry.sphere import sample_sphere
from gensp.geometry.spherical_map import SphericalMap


def test_square_and_sphere_are_inverse(rng: np.random.Generator) -> None:
    p = sample_sphere(2000, rng)
    st = octahedral_coordinates(p)
    assert np.abs(st).max() <= 1
    np.testing.assert_allclose(octahedral_directions(st), p, atol=1e-14)


def test_known_places() -> None:
    middle, corner, right = octahedral_directions(np.array([[0.0, 0], [1, -1], [1, 0]]))
    np.testing.assert_allclose(middle, [0, 0, 1])
    np.testing.assert_allclose(corner, [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(right, [1, 0, 0])


@pytest.mark.parametrize("size", [16, 17])
def test_border_closes(size: int, bumpy_map: SphericalMap) -> None:
    image = geometry_image(bumpy_map, size)
    for border in (image[0], image[-1], image[:, 0], image[:, -1]):
        np.testing.assert_allclose(border, border[::-1], atol=1e-12)
    grid = octahedral_grid(size)
    np.testing.assert_allclose(
        image / np.linalg.norm(image, axis=2, keepdims=True), grid, atol=0.03
    )


def test_files_give_the_positions_back(bumpy_map: SphericalMap, tmp_path: Path) -> None:
    image = geometry_image(bumpy_map, 24)
    png, sidecar, exr = write_geometry_image(image, tmp_path / "image.png")
    stored = OpenEXR.File(str(exr), separate_channels=True).channels()
    for axis, colour in enumerate("RGB"):
        floats = stored[colour].pixels
        assert floats.dtype == np.float32
        np.testing.assert_array_equal(floats, image[:, :, axis].astype(np.float32))
    told = json.loads(sidecar.read_text())
    back = np.array(told["offset"]) + np.array(told["scale"]) * _read_png(png) / 65535
    assert np.abs(back - image).max() <= 0.51 * max(told["scale"]) / 65535


def test_other_readers_see_the_same_picture(tmp_path: Path, rng: np.random.Generator) -> None:
    values = rng.integers(0, 65536, (7, 5, 3)).astype(np.uint16)
    path = tmp_path / "noise.png"
    path.write_bytes(png_bytes(values))
    np.testing.assert_array_equal(_read_png(path), values)
    with Image.open(path) as seen:
        # Pillow keeps the upper byte.
        np.testing.assert_array_equal(np.asarray(seen.convert("RGB")), values >> 8)


def _read_png(path: Path) -> np.ndarray:
    """16-bit colours of an unfiltered PNG of one IDAT chunk."""
    data = path.read_bytes()
    width, height = (int.from_bytes(data[k : k + 4], "big") for k in (16, 20))
    at = data.index(b"IDAT")
    length = int.from_bytes(data[at - 4 : at], "big")
    rows = np.frombuffer(zlib.decompress(data[at + 4 : at + 4 + length]), np.uint8)
    rows = rows.reshape(height, 1 + 6 * width)
    assert not rows[:, 0].any()
    return np.ascontiguousarray(rows[:, 1:]).view(">u2").reshape(height, width, 3)


def test_impossible_size_is_named() -> None:
    with pytest.raises(Unsupported, match="2 pixels a side; 3 to 4097 are possible"):
        octahedral_grid(2)
