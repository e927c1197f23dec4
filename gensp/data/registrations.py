"""The files of D-FAUST: which sequences they hold, and whether they can hold what they declare.

A file of HDF5 may declare any number of frames without having one: what it declares is compared
with its size before anything is made of it.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from gensp.errors import GenSPError, MissingData, UnreadableMesh

_PATTERN = "registrations_*.hdf5"
_NEEDED = "faces (F, 3) and <subject>_<sequence> (V, 3, frames)"
_REMEDY = "download it again"

# Bytes declared for a byte of the file. Coordinates of bodies shrink to a half when they are
# compressed; DEFLATE itself ends at 1032.
RATIO = 100
FRAMES = 1_000_000  # of all sequences together; D-FAUST has 41,220
_LARGEST = 2**31  # bytes of one frame, of the faces or of a chunk, as double numbers


@dataclass(frozen=True)
class Motion:
    """One dataset <subject>_<sequence> of a file: so many frames (V, 3, frames)."""

    subject: str
    name: str
    file: Path
    frames: int

    @property
    def key(self) -> str:
        """Name of the dataset in its file."""
        return f"{self.subject}_{self.name}"


def listed(root: Path) -> dict[str, Motion]:
    """The sequences of all files in a folder, by their keys.

    Raises
    ------
    MissingData
        There is no such file.
    UnreadableMesh
        A file is no such file, declares more than it can hold, or repeats a sequence of another.
    """
    files = sorted(root.glob(_PATTERN)) if root.is_dir() else []
    if not files:
        raise MissingData(
            f"{root}: has no {_PATTERN}; the registrations of D-FAUST are required; set "
            "shapes.root=FOLDER"
        )
    found: dict[str, Motion] = {}
    for entry in (entry for path in files for entry in _sequences(path)):
        if entry.key in found:
            raise UnreadableMesh(
                f"{entry.file}: has '{entry.key}', which {found[entry.key].file} has too; every "
                "<subject>_<sequence> is required once; remove one of the files"
            )
        found[entry.key] = entry
    _require_few(root, sum(entry.frames for entry in found.values()))
    return found


def chosen(sequences: list[Motion], places: Int[np.ndarray, " k"]) -> list[str]:
    """Ids <key>_<frame> of some of all frames, numbered through one sequence after another."""
    ends = np.cumsum([entry.frames for entry in sequences], dtype=np.int64)
    which = np.searchsorted(ends, places, side="right")
    return [
        f"{sequences[k].key}_{place - ends[k] + sequences[k].frames:05d}"
        for k, place in zip(which, places, strict=True)
    ]


def _require_few(root: Path, frames: int) -> None:
    if frames > FRAMES:
        raise UnreadableMesh(
            f"{root}: the files declare {frames} frames; at most {FRAMES} of all sequences are "
            "required (D-FAUST has 41220); download them again"
        )


def _sequences(path: Path) -> Iterator[Motion]:
    with opened(path) as file:
        if "faces" not in file:
            raise _refused(path, "has no dataset 'faces'")
        declared = 0
        for key in sorted(file):
            dataset = _dataset(path, file, key)
            declared += _declared(path, dataset)
            if key != "faces":
                subject, name = key.split("_", 1)
                yield Motion(subject, name, path, int(dataset.shape[2]))
        _require_held(path, "its datasets declare", declared, path.stat().st_size)


def _dataset(path: Path, file: Any, key: str) -> Any:
    """A dataset of numbers of the right shape, whose bytes lie in the file itself."""
    # Seen before it is followed: a link may lead to another file, also by way of a second.
    elsewhere = hasattr(file.get(key, getlink=True), "path")
    dataset = None if elsewhere else file[key]
    shape = getattr(dataset, "shape", None) or ()
    if elsewhere or getattr(dataset, "external", None) or getattr(dataset, "is_virtual", False):
        raise _refused(path, f"'{key}' is a link, or lies in another file")
    right = len(shape) == 2 if key == "faces" else "_" in key and len(shape) == 3
    if not right or shape[1] != 3 or dataset.dtype.kind not in "fiu":
        raise _refused(path, f"'{key}' has the shape {shape} of {getattr(dataset, 'dtype', None)}")
    return dataset


def _declared(path: Path, dataset: Any) -> int:
    """Bytes that a dataset, or what of it is read at once, takes when it is unpacked.

    Raises
    ------
    UnreadableMesh
        More than the bytes that it has can hold, or than may be read at once.
    """
    name, chunk = dataset.name.strip("/"), math.prod(dataset.chunks or (0,))
    frame = math.prod(dataset.shape[:2])
    if 8 * max(frame, chunk) > _LARGEST:
        raise _refused(path, f"'{name}' declares more than 2 GiB in one frame or chunk")
    declared = max(math.prod(dataset.shape), chunk) * int(dataset.dtype.itemsize)
    _require_held(path, f"'{name}' declares", declared, dataset.id.get_storage_size())
    return declared


def _require_held(path: Path, what: str, declared: int, held: int) -> None:
    if declared > RATIO * held:
        found = f"{what} {declared} bytes, of which {held} are there"
        raise _refused(path, f"{found} (more than {RATIO} for one)")


def _refused(path: Path, found: str) -> UnreadableMesh:
    return UnreadableMesh(f"{path}: {found}; {_NEEDED} are required; {_REMEDY}")


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An HDF5 file; whatever its reader says of it in one line."""
    # Imported late: only this collection needs it.
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except GenSPError:
        raise
    # The reader of a damaged file raises whatever it met; the file is at fault in each case.
    except Exception as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}: {str(error)[:80]}); a whole HDF5 "
            f"file of registrations is required; {_REMEDY}"
        ) from error
