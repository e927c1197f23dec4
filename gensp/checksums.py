"""Checksums of a folder's files: noted when a stage is sealed, compared when another reads it.

The list of a stage is a file of its own, a line for each of its files, which the manifest seals by
the checksum of the list. It is written, checked and read line by line, so that memory does not
grow with the number of files.
"""

import csv
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from gensp.errors import DamagedFile
from gensp.files import atomic_path

MANIFEST = "manifest.json"
FILES = "files.csv"
# What loggers keep open, and may grow after the seal.
LOGGED = {"logs", "wandb"}


class Listed(NamedTuple):
    """One file: its name below the folder, with slashes, its bytes, and its SHA-256 in hex."""

    file: str
    bytes: int
    sha256: str


def listing(folder: Path) -> Iterator[Listed]:
    """Every file below a folder, by name; manifest, list and hidden files are left out."""
    for name in _names(folder):
        path = folder / name
        if name != FILES and path.name != MANIFEST and not path.name.startswith("."):
            yield Listed(name, path.stat().st_size, file_hash(path))


def _names(folder: Path, above: str = "") -> Iterator[str]:
    """Names of all files below a folder, ordered as texts though no more than a folder is held."""
    with os.scandir(folder / above) as entries:
        # With its slash a folder stands where the names of its files do: "a.csv", "a/b", "ab".
        found = sorted(
            entry.name + "/" if entry.is_dir(follow_symlinks=False) else entry.name
            for entry in entries
            if entry.is_dir(follow_symlinks=False) or entry.is_file()
        )
    for name in found:
        if name.endswith("/"):
            yield from _names(folder, above + name)
        else:
            yield above + name


def inline(files: Iterable[Listed]) -> dict[str, dict[str, Any]]:
    """A few files as a table within JSON: name → bytes and checksum."""
    return {entry.file: {"bytes": entry.bytes, "sha256": entry.sha256} for entry in files}


def write_list(folder: Path) -> dict[str, Any]:
    """Write the list of a folder's files; gives what seals it: count, bytes of all, checksum."""
    count = size = 0
    with atomic_path(folder / FILES) as temporary, _opened(temporary, "w") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Listed._fields)
        for entry in listing(folder):
            writer.writerow(entry)
            count, size = count + 1, size + entry.bytes
    return {"count": count, "bytes": size, "sha256": file_hash(folder / FILES)}


def listed(folder: Path, files: Mapping[str, Any]) -> Iterator[Listed]:
    """The files that a manifest tells of, by name.

    Parameters
    ----------
    files
        The manifest's entry: what `write_list` gave; or the table of `inline`, as in manifests
        that were written before the list was a file of its own.

    Raises
    ------
    DamagedFile
        The list is missing or was changed, or the entry is none. Nothing is read before the whole
        list was compared with its checksum.
    """
    with _told(folder):
        table = _table(files)
        sealed = "" if table else str(files["sha256"])
    if table:
        return iter(table)
    path = folder / FILES
    if not path.is_file() or file_hash(path) != sealed:
        found = "was changed since it was written" if path.is_file() else "is missing"
        raise DamagedFile(
            f"{path}: {found}; the whole list of what the stage left is required; restore the "
            "file, or make the stage anew with force=true"
        )
    return _lines(path)


def _lines(path: Path) -> Iterator[Listed]:
    with _opened(path, "r") as file:
        lines = csv.reader(file)
        next(lines)
        yield from (Listed(name, int(size), digest) for name, size, digest in lines)


def _opened(path: Path, mode: str) -> Any:
    # Names that are no UTF-8 pass through as they are.
    return open(path, mode, encoding="utf-8", errors="surrogateescape", newline="")


def totals(folder: Path, files: Mapping[str, Any]) -> tuple[int, int]:
    """How many files a manifest tells of, and their bytes; see `listed`.

    Raises
    ------
    DamagedFile
        Its entry tells neither.
    """
    with _told(folder):
        if table := _table(files):
            return len(table), sum(entry.bytes for entry in table)
        return int(files["count"]), int(files["bytes"])


def _table(files: Mapping[str, Any]) -> list[Listed]:
    """The files of `inline`, by name; nothing where the list is a file of its own."""
    if not all(isinstance(entry, Mapping) for entry in files.values()):
        return []
    return sorted(Listed(name, int(e["bytes"]), str(e["sha256"])) for name, e in files.items())


@contextmanager
def _told(folder: Path) -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamagedFile(
            f"{folder / MANIFEST}: is damaged (does not tell of its files); the record of a stage "
            "is required; restore it, or make the stage anew with force=true"
        ) from error


def require_intact(folder: Path, files: Iterable[Listed], stage: str) -> None:
    """Compare the results of a finished stage with the checksums of when it was sealed.

    Raises
    ------
    DamagedFile
        A file is missing or was changed.
    """
    for entry in files:
        path = folder / entry.file
        if LOGGED & set(entry.file.split("/")):
            continue
        if not path.is_file() or file_hash(path) != entry.sha256:
            found = "was changed since" if path.is_file() else "is missing"
            raise DamagedFile(
                f"{path}: {found}; what the stage '{stage}' left is required; "
                "restore the file, or make the stage anew with "
                f"stage={stage} force=true"
            )


def digest_of(files: Iterable[Listed]) -> str:
    """The `content_hash` of the table name → checksum of files that come by name, line by line."""
    digest, separator = hashlib.sha256(b"{"), ""
    for entry in files:
        digest.update(f"{separator}{json.dumps(entry.file)}: {json.dumps(entry.sha256)}".encode())
        separator = ", "
    digest.update(b"}")
    return digest.hexdigest()[:16]


def file_hash(path: Path) -> str:
    """The SHA-256 of a file's content."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
