"""Geometry images in files: 16-bit PNG with its scale beside it, and 32-bit float OpenEXR.

Pillow writes no colour PNG of 16 bits, so the few chunks of one are put together here
(PNG specification, third edition, section 11). OpenEXR is written by its own library.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float, Float32, UInt16

from gensp.files import atomic_path, write_json

_LARGEST = 65_535


def write_geometry_image(positions: Float[np.ndarray, "h w 3"], path: Path) -> list[Path]:
    """Write `path` as 16-bit PNG, its scale as JSON and the floats as EXR, named alike.

    A position is offset + scale · value / 65535, for every coordinate. Returns the three files.
    """
    low, high = positions.min(axis=(0, 1)), positions.max(axis=(0, 1))
    # A flat direction has no extent: any scale gives back its one coordinate.
    scale = np.where(high > low, high - low, 1.0)
    values = np.rint(_LARGEST * (positions - low) / scale).astype(np.uint16)
    png, sidecar, exr = (path.with_suffix(end) for end in (".png", ".json", ".exr"))
    with atomic_path(png) as temporary:
        temporary.write_bytes(png_bytes(values))
    write_json(
        sidecar,
        {
            "offset": low,
            "scale": scale,
            "formula": "position = offset + scale * value / 65535",
            "layout": "octahedral: column j, row i at s = -1 + 2j/(N-1), t = 1 - 2i/(N-1)",
            "size": positions.shape[0],
        },
    )
    with atomic_path(exr) as temporary:
        _write_exr(positions.astype(np.float32), temporary)
    return [png, sidecar, exr]


def _write_exr(values: Float32[np.ndarray, "h w 3"], path: Path) -> None:
    """Colours R, G, B of 32 bits, compressed without loss, row by row from the top."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(values)}).write(str(path))


def png_bytes(values: UInt16[np.ndarray, "h w 3"]) -> bytes:
    """A PNG file of 16 bits per colour."""
    height, width = values.shape[:2]
    rows = np.zeros((height, 1 + 6 * width), dtype=np.uint8)  # a zero in front: no filter
    rows[:, 1:] = values.astype(">u2").view(np.uint8).reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    check = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)
