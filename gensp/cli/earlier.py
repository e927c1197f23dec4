"""What may be written over: only files that gensp itself has written there earlier."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gensp.errors import OutputError
from gensp.geometry.spherical_map import PLY_COMMENT
from gensp.geometry.wavefront import read_obj

_HEADER = 4096  # bytes: the header of a map's PLY is a tenth of that
_UNIT = 1e-6  # how far from 1 the lengths of a map's positions may be


def require_earlier(mesh: Path, written: Iterable[Path]) -> None:
    """Refuse to write over a mesh, or arrays, that only happen to have the name of a result.

    Raises
    ------
    OutputError
        A file lies at one of the places, and it is none that gensp writes there.
    """
    for path in written:
        if path.exists() and not is_earlier(path):
            raise OutputError(
                f"{path}: is no result of gensp, and would be overwritten by that of {mesh}; "
                "another place is required; add --out FOLDER"
            )


def is_earlier(path: Path) -> bool:
    """Whether a file is a map, its sphere or its textured shape, as far as its kind can tell."""
    known = {".ply": _is_map_ply, ".npz": _is_map_npz, ".obj": _is_sphere_or_textured}
    kind = known.get(path.suffix.lower())
    try:
        return kind is None or kind(path)
    # What cannot be read was not written here: results are whole.
    except (OSError, ValueError, zipfile.BadZipFile):
        return False


def _is_map_ply(path: Path) -> bool:
    with open(path, "rb") as file:
        return f"comment {PLY_COMMENT}\n".encode() in file.read(_HEADER)


def _is_map_npz(path: Path) -> bool:
    with zipfile.ZipFile(path) as arrays:
        return "sphere.npy" in arrays.namelist()


def _is_sphere_or_textured(path: Path) -> bool:
    with open(path, encoding="utf-8", errors="replace") as file:
        if any(line == "usemtl sphere\n" for line in file):
            return True
    lengths = np.linalg.norm(read_obj(path)[0], axis=1)
    return len(lengths) > 0 and bool(np.all(np.abs(lengths - 1) < _UNIT))
