"""Files that are whole or absent: everything is written beside its place and renamed onto it."""

import csv
import hashlib
import io
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy

from gensp.errors import DamagedFile, OutputError

_LARGEST_ARRAYS = 2**31  # bytes of an npz when unpacked; a damaged or hostile file may claim more
_REMEDY = "restore or remove the file"


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary sibling of `path` that is renamed onto it when the block succeeds.

    The temporary keeps the suffix, because writers choose their format by it. It is removed when
    the block fails.

    Raises
    ------
    OutputError
        The disk is full or read-only, or the folder may not be written.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        yield temporary
        _flush(temporary)
        os.chmod(temporary, permitted(0o666))
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error, "paths.runs") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    # A full disk may only show when the data really reaches it.
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def permitted(mode: int) -> int:
    """The mode without what the umask takes away, which temporaries are made without."""
    mask = os.umask(0)
    os.umask(mask)
    return mode & ~mask


def unwritable(path: Path, error: OSError, word: str) -> OutputError:
    """The one line for a file or folder that cannot be written; `word` names another place."""
    return OutputError(
        f"{path}: cannot be written ({error.strerror or error}); free space or permission is "
        f"required; name another folder with {word}=FOLDER"
    )


def near(path: Path) -> Path:
    """A path as it is seen from the working directory, where it is below that.

    Absolute paths are for workers elsewhere; what is told and kept should not depend on where.
    """
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def write_text(path: Path | str, text: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as indented JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=2, default=_plain) + "\n")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises
    ------
    DamagedFile
        It is no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise DamagedFile(_damaged(path, "JSON", error)) from error


def read_rows(path: Path | str) -> list[dict[str, str]]:
    """Rows of a table with commas, headed by the names of its columns; all values are texts.

    Raises
    ------
    DamagedFile
        It is no such table, or a row is longer than the head.
    """
    try:
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, restval=""))
    except (ValueError, csv.Error) as error:
        raise DamagedFile(_damaged(path, "table", error)) from error
    if any(None in row for row in rows):
        raise DamagedFile(_damaged(path, "table", "a row longer than the head"))
    return rows


def read_yaml(path: Path | str) -> Any:
    """Read a YAML file of plain values, such as the configuration of a run.

    Raises
    ------
    DamagedFile
        It is no YAML, asks for objects, or repeats values by name: a few such lines stand for
        more values than memory holds.
    """
    # Imported late: hardly a command reads one.
    import yaml

    try:
        text = Path(path).read_text(encoding="utf-8")
        if "*" in text and any(isinstance(word, yaml.AliasToken) for word in yaml.scan(text)):
            raise ValueError("values repeated by name")
        return yaml.safe_load(text)
    # Constructors of dates and numbers raise what they meet; the file is at fault in each case.
    except (yaml.YAMLError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise DamagedFile(_damaged(path, "YAML", error)) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is not plain data")


def save_npz(path: Path | str, **arrays: Any) -> None:
    """Write named arrays to a compressed npz, whole or not at all."""
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def load_npz(path: Path | str) -> dict[str, np.ndarray]:
    """Read all arrays of an npz; pickled objects are refused.

    Raises
    ------
    DamagedFile
        It is no npz of plain arrays, or would need more than 2 GiB.
    """
    with open(path, "rb") as file:
        try:
            return _arrays(file)
        # Parsers of damaged files raise whatever they meet; the file is at fault in each case.
        except Exception as error:
            raise DamagedFile(_damaged(path, "npz", error)) from error


def _arrays(file: BinaryIO) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(file) as archive:
        members = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
        if sum(entry.file_size for entry in members) > _LARGEST_ARRAYS:
            raise ValueError("more than 2 GiB of arrays")
        # Every member with its checksum: no array is made of unchecked bytes.
        return {entry.filename[:-4]: _array(archive.read(entry)) for entry in members}


def _array(data: bytes) -> np.ndarray:
    """An array from the content of a npy file, whose head must agree with its length."""
    stream = io.BytesIO(data)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    version = npy.read_magic(stream)
    if version not in readers:
        raise ValueError(f"npy of version {version}")
    shape, fortran, dtype = readers[version](stream)
    if dtype.hasobject:
        raise ValueError("pickled objects")
    content = bytearray(data[stream.tell() :])
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(content):
        raise ValueError(f"an array {shape} in {len(content)} bytes")
    return np.ndarray(shape, dtype, content, order="F" if fortran else "C")


def require_whole_archive(path: Path | str, remedy: str = _REMEDY) -> None:
    """Check the checksums of an archive of torch (model.pt, checkpoint), which torch does not.

    Parameters
    ----------
    remedy
        What to do with a damaged file, for the error.

    Raises
    ------
    DamagedFile
        It is no such archive, a byte of its content is not what was written, or it would unpack
        to more than its own size.
    """
    with open(path, "rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                unpacked = sum(entry.file_size for entry in archive.infolist())
                spoilt = archive.testzip() if unpacked <= os.fstat(file.fileno()).st_size else ""
        except Exception as error:
            raise DamagedFile(_damaged(path, "archive", error, remedy)) from error
    if spoilt is not None:
        found = f"{spoilt} was changed" if spoilt else f"{unpacked} bytes when unpacked"
        raise DamagedFile(_damaged(path, "archive", found, remedy))


def _damaged(path: Path | str, kind: str, found: object, remedy: str = _REMEDY) -> str:
    reason = f"{type(found).__name__}: {found}" if isinstance(found, Exception) else str(found)
    return (
        f"{path}: is damaged ({' '.join(reason.split())[:120]}); a whole {kind} is required; "
        f"{remedy}"
    )


def content_hash(*values: Any) -> str:
    """Sixteen hexadecimal digits that depend on the content of arrays, numbers and texts."""
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(json.dumps(value, sort_keys=True, default=_plain).encode())
    return digest.hexdigest()[:16]
