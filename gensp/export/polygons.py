"""Binary PLY in double precision, with or without vertex colours."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gensp.files import atomic_path
from gensp.geometry.mesh import Mesh

_CHANNELS = ("red", "green", "blue", "alpha")


def write_ply(path: Path, mesh: Mesh, colours: UInt8[np.ndarray, "n c"] | None = None) -> None:
    """Write positions as doubles, so that nothing is folded or flattened by rounding.

    `colours` has three or four bytes a vertex.
    """
    bytes_ = np.zeros((len(mesh.vertices), 0), np.uint8) if colours is None else colours
    channels = _CHANNELS[: bytes_.shape[1]]
    vertex = np.empty(
        len(mesh.vertices), dtype=[("x", "<f8", (3,)), ("c", "u1", (len(channels),))]
    )
    vertex["x"], vertex["c"] = mesh.vertices, bytes_
    face = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    face["count"], face["corners"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertex)}",
        *(f"property double {name}" for name in "xyz"),
        *(f"property uchar {name}" for name in channels),
        f"element face {len(face)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + vertex.tobytes() + face.tobytes())
