"""Every mesh of a collection is checked once; verdicts are kept by file content.

Where all are known from before, no geometry is loaded.
"""

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from gensp.errors import BadMesh, DamagedFile, MissingData, Unsupported
from gensp.files import near, read_json, write_json
from gensp.geometry.formats import MAX_FACES

if TYPE_CHECKING:
    from gensp.geometry.mesh import Mesh

KEEP = "keep"  # nothing is checked here, because stage=prepare does it
_RECORD = "genus_zero.json"
_FEWEST = 4  # faces of a closed surface


class _Named(Protocol):
    @property
    def id(self) -> str: ...
    @property
    def path(self) -> Path: ...


ShapeT = TypeVar("ShapeT", bound=_Named)


def checked(
    shapes: Sequence[ShapeT], *, on_bad: str, max_faces: int | None, cache: Path | str | None
) -> tuple[list[ShapeT], list[tuple[str, str]]]:
    """Split shapes into the sound ones and (id, reason) of the others.

    Parameters
    ----------
    max_faces
        Larger meshes are bad; none is `MAX_FACES`.
    cache
        Folder for the digests of files that have passed; a file is checked again when its content
        or `max_faces` changes.

    Raises
    ------
    BadMesh
        Under on_bad=error, with one line for every bad file.
    MissingData
        No sound mesh is left.
    """
    if on_bad == KEEP:
        return list(shapes), []
    if on_bad not in ("error", "skip"):
        raise Unsupported(f"on_bad={on_bad}: is not known; error or skip is required; choose one")
    record = None if cache is None else Path(cache) / _RECORD
    passed = _read_record(record)
    known = len(passed)
    most = MAX_FACES if max_faces is None else max_faces
    reasons = {shape.id: _verdict(near(shape.path), most, passed) for shape in shapes}
    if record is not None and len(passed) > known:
        write_json(record, sorted(passed))
    bad = [(id, reason) for id, reason in reasons.items() if reason is not None]
    lines = "\n".join(reason for _, reason in bad)
    if bad and on_bad == "error":
        raise BadMesh(
            f"{len(bad)} of {len(shapes)} meshes cannot be used; mend them, or leave them out "
            f"with on_bad=skip:\n{lines}"
        )
    sound = [shape for shape in shapes if reasons[shape.id] is None]
    if not sound:
        raise MissingData(f"none of {len(shapes)} meshes can be used; one is required:\n{lines}")
    return sound, bad


def _verdict(path: Path, max_faces: int, passed: set[str]) -> str | None:
    """Reason to reject a file, in one line, or nothing."""
    try:
        digest = _digest(path, max_faces)
        if digest in passed:
            return None
        from gensp.geometry.mesh import load_mesh, require_genus_zero

        mesh = replace(load_mesh(path), name=str(path))
    except BadMesh as error:
        return " ".join(str(error).split())
    except OSError as error:
        return f"{path}: cannot be opened ({error.strerror}); a readable file is required"
    try:
        require_genus_zero(mesh, max_faces=max_faces)
    except BadMesh as error:
        return f"{error}{_way_out(path, mesh, max_faces)}"
    passed.add(digest)
    return None


def _way_out(path: Path, mesh: "Mesh", max_faces: int) -> str:
    """The command that mends a mesh, unless there is nothing to mend."""
    if len(mesh.faces) < _FEWEST:
        return ""
    from gensp.geometry.diagnosis import diagnose, repair_command

    return f", or type: {repair_command(path, diagnose(mesh, max_faces=max_faces))}"


def _digest(path: Path, max_faces: int) -> str:
    content = path.read_bytes() if path.is_file() else b""
    return hashlib.sha256(content + f"{path.suffix}{max_faces}".encode()).hexdigest()


def _read_record(record: Path | None) -> set[str]:
    if record is None or not record.is_file():
        return set()
    try:
        return set(read_json(record))
    except (DamagedFile, TypeError):
        warnings.warn(f"{record}: damaged; all meshes are checked again", stacklevel=2)
        return set()
