"""Arrays on disk from which batches are drawn: mapped row by row, checked, made anew if damaged.

Nothing of an array stays in memory between two draws, so what a training needs does not grow with
the collection.
"""

import os
import re
import shutil
import socket
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.lib import format as npy
from torch import Tensor

from gensp.checksums import MANIFEST, inline, listed, listing, require_intact
from gensp.errors import DamagedFile, OutputError
from gensp.files import load_npz, permitted, read_json, unwritable, write_json

# Writes the arrays of a store into a folder, see `write_rows`.
Writer = Callable[[Path], None]

_WEEK = 7 * 24 * 3600  # seconds; no writer leaves its folder untouched for so long


class MappedArray:
    """A npy file of which only the rows asked for are read.

    Indices are those of numpy; what comes out is a tensor of its own.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        found = self.mapped()
        self.shape, self.dtype = found.shape, found.dtype

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, index: Any) -> Tensor:
        return torch.from_numpy(np.array(self.mapped()[_plain(index)]))

    def mapped(self) -> np.ndarray:
        """The file as an array in the address space, for as long as the array is held.

        Raises
        ------
        DamagedFile
            It was removed or cut short since it was checked.
        """
        try:
            array: np.ndarray = np.load(self.path, mmap_mode="r")
        except (OSError, ValueError, EOFError) as error:
            reason = " ".join(str(error).split())[:120]
            raise DamagedFile(
                f"{self.path}: cannot be read any more ({reason}); the array that the training "
                "began with is required; run the same command again: it is made anew"
            ) from error
        return array


def _plain(index: Any) -> Any:
    if isinstance(index, tuple):
        return tuple(map(_plain, index))
    return index.numpy() if isinstance(index, Tensor) else index


def stored(folder: Path, key: str, write: Writer) -> dict[str, MappedArray]:
    """The arrays of a store by name; it is written where it is missing or damaged.

    Parameters
    ----------
    folder, key
        Where such stores are kept, and what the content of this one depends on.
    write
        Writes its npy files.

    Raises
    ------
    OutputError
        The disk is full or read-only, the folder may not be written, or a damaged one not removed.
    """
    place = folder / key
    _sweep(folder)
    if place.exists() and not _whole(place):
        warnings.warn(f"{place}: damaged; it is made anew", stacklevel=2)
        _remove(place)
    if not place.exists():
        with _atomic_folder(place) as made:
            write(made)
            write_json(made / MANIFEST, inline(listing(made)))
    return {path.stem: MappedArray(path) for path in sorted(place.glob("*.npy"))}


def _whole(place: Path) -> bool:
    """Whether the manifest lists every array, and each is as it was written."""
    try:
        files = read_json(place / MANIFEST)
        require_intact(place, listed(place, files), "data")
        return {path.name for path in place.glob("*.npy")} <= files.keys()
    except (OSError, TypeError, AttributeError, KeyError, DamagedFile):
        return False


def _remove(place: Path) -> None:
    shutil.rmtree(place, ignore_errors=True)
    # Another run may have made it anew meanwhile.
    if place.exists() and not _whole(place):
        raise OutputError(
            f"{place}: is damaged and cannot be removed; permission to remove it is required; "
            "remove it by hand, or name another folder with paths.cache=FOLDER"
        )


def _sweep(folder: Path) -> None:
    """Remove the folders of writers that were killed."""
    for left in folder.glob(".*-*"):
        if _abandoned(left):
            shutil.rmtree(left, ignore_errors=True)


def _abandoned(left: Path) -> bool:
    """Whether the process that its name tells is gone; of another machine's, age must tell."""
    writer = re.fullmatch(r"\.[^-]+-(?P<host>.+)-(?P<process>\d+)-\w+", left.name)
    # Elsewhere than on POSIX, signal 0 would not merely ask.
    if os.name == "posix" and writer and writer["host"] == socket.gethostname():
        return not _runs(int(writer["process"]))
    try:
        changed = max(path.stat().st_mtime for path in (left, *left.iterdir()))
    except OSError:  # it is being renamed or removed
        return False
    return time.time() - changed > _WEEK


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


@contextmanager
def _atomic_folder(place: Path) -> Iterator[Path]:
    """A folder beside its place, renamed onto it when the block succeeds."""
    made: Path | None = None
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        writer = f".{place.name}-{socket.gethostname()}-{os.getpid()}-"
        made = Path(tempfile.mkdtemp(prefix=writer, dir=place.parent))
        yield made
        _settle(made, place)
    except OSError as error:
        raise unwritable(place, error, "paths.cache") from error
    finally:
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)


def _settle(made: Path, place: Path) -> None:
    made.chmod(permitted(0o777))
    try:
        os.rename(made, place)
    except OSError:
        # Another run was faster; what it wrote under the same key is the same.
        if not place.is_dir():
            raise


def write_rows(
    path: Path, blocks: Iterable[np.ndarray], shape: Sequence[int], dtype: np.dtype | type
) -> None:
    """Write an array of the given shape, block of rows after block of rows.

    Raises
    ------
    ValueError
        The blocks do not fill the shape.
    """
    dtype, written = np.dtype(dtype), 0
    with open(path, "wb") as file:
        head = {
            "descr": npy.dtype_to_descr(dtype),
            "fortran_order": False,
            "shape": tuple(map(int, shape)),
        }
        npy.write_array_header_1_0(file, head)
        for block in blocks:
            data = np.ascontiguousarray(block, dtype=dtype)
            written += data.size
            file.write(data.data)
        file.flush()
        os.fsync(file.fileno())
    if written != np.prod(shape, dtype=np.int64):
        raise ValueError(f"{path.name}: {written} numbers for the shape {tuple(shape)}")


class Entries(Sequence[np.ndarray]):
    """One array of every file, read when asked for."""

    def __init__(self, files: Sequence[Path], name: str) -> None:
        self.files, self.name = files, name

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, place: Any) -> Any:
        return load_npz(self.files[place])[self.name]


class Chosen:
    """Some items of a mapped array, of which again some are read."""

    def __init__(self, array: MappedArray, items: Sequence[int]) -> None:
        self.array, self.items = array, items

    def __getitem__(self, kept: Sequence[int]) -> np.ndarray:
        return self.array[[self.items[k] for k in kept]].numpy()
