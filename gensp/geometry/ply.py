"""Binary ply files with double precision vertex properties."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int


def ply_bytes(
    names: Sequence[str],
    values: Float[np.ndarray, "n c"],
    faces: Int[np.ndarray, "m 3"],
    comment: str = "",
) -> bytes:
    """A triangle mesh with named vertex properties, little-endian doubles.

    Text, or single precision, would fold tiny faces by rounding.
    """
    face = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    face["count"], face["corners"] = 3, faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *([f"comment {comment}"] if comment else []),
        f"element vertex {len(values)}",
        *(f"property double {name}" for name in names),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode() + values.astype("<f8").tobytes() + face.tobytes()
