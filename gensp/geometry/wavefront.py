"""Wavefront obj files: the vertices as listed and the faces over them, whatever else is there.

General readers split vertices by texture coordinate, normal, group or material, which opens closed
surfaces and loses the file's vertex order.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int


def read_obj(path: Path) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Positions and triangles of all groups; polygons become fans.

    Raises
    ------
    ValueError
        A number cannot be read, or a face names a vertex that is not there.
    """
    vertices: list[list[str]] = []
    faces: list[tuple[int, int, int]] = []
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in _whole_lines(file):
            words = line.split()
            if line.startswith("v") and words[0] == "v":
                vertices.append(words[1:4])
            elif line.startswith("f") and words[0] == "f":
                corners = [_place(word, len(vertices)) for word in words[1:]]
                faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    positions = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.array(faces, dtype=np.int64).reshape(-1, 3)
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(positions):
        raise ValueError(f"a face names a vertex outside the {len(positions)} of the file")
    return positions, triangles


def _whole_lines(file: Iterable[str]) -> Iterator[str]:
    """The lines, those of vertices and faces that end with a backslash joined to the next."""
    held = ""
    for line in file:
        if line.endswith("\\\n") and (held or line.startswith(("v", "f"))):
            held += line[:-2] + " "
            continue
        yield held + line
        held = ""
    if held:
        yield held


def _place(word: str, known: int) -> int:
    """Index of a corner "v", "v/vt", "v//vn" or "v/vt/vn"; negative ones count backwards."""
    index = int(word.split("/")[0])
    return known + index if index < 0 else index - 1
