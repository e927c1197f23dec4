"""Checksums of a folder's files: noted when a stage is sealed, compared when another reads it."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gensp.errors import DamagedFile

MANIFEST = "manifest.json"
# What loggers keep open, and may grow after the seal.
LOGGED = {"logs", "wandb"}


def listing(folder: Path) -> dict[str, dict[str, Any]]:
    """Size and SHA-256 of every file below a folder, the manifest and hidden files left out."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    kept = [path for path in paths if path.name != MANIFEST and not path.name.startswith(".")]
    return {
        path.relative_to(folder).as_posix(): {
            "bytes": path.stat().st_size,
            "sha256": _file_hash(path),
        }
        for path in kept
    }


def require_intact(folder: Path, files: Mapping[str, Mapping[str, Any]], stage: str) -> None:
    """Compare the results of a finished stage with the checksums in its manifest.

    Parameters
    ----------
    files
        What `listing` gave when the stage was sealed.

    Raises
    ------
    DamagedFile
        A file is missing or was changed.
    """
    for name, entry in files.items():
        path = folder / name
        if LOGGED & set(name.split("/")):
            continue
        if not path.is_file() or _file_hash(path) != entry["sha256"]:
            found = "was changed since" if path.is_file() else "is missing"
            raise DamagedFile(
                f"{path}: {found}; what the stage '{stage}' left is required; "
                "restore the file, or make the stage anew with "
                f"stage={stage} force=true"
            )


def _file_hash(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
