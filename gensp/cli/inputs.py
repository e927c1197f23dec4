"""What the commands read, and where they write: sound meshes, maps, methods, places."""

import os
import shlex
from pathlib import Path

from gensp.cli.earlier import is_earlier
from gensp.cli.terminal import compile_announced, progress
from gensp.errors import DamagedFile, NotGenusZero, OutputError, UnreadableMesh, Unsupported
from gensp.files import load_npz
from gensp.geometry.diagnosis import diagnose, repair_command
from gensp.geometry.mesh import FORMATS, Mesh, load_mesh
from gensp.geometry.spherical_map import SphericalMap, map_fault, map_from
from gensp.methods import SphericalParameterization


def sound_mesh(path: Path) -> Mesh:
    """Read a mesh that can go to the sphere.

    Raises
    ------
    BadMesh
        It cannot be read, or has a fault: all of them in one line, with the remedy.
    """
    mesh = load_mesh(path)
    found = diagnose(mesh)
    if not found.usable:
        what = ", ".join(words for words, _ in found.findings)
        only_large = found.too_large and len(found.findings) == 1
        required = "fewer faces are" if only_large else "one closed surface of genus 0 is"
        raise NotGenusZero(
            f"{path}: {what}; {required} required; type: {repair_command(path, found)}"
        )
    return mesh


def require_other(mesh: Path, written: Path, *, by: str, remedy: str) -> None:
    """Refuse to write over the mesh that is read: colours or parts of it would be lost.

    Raises
    ------
    OutputError
        Both are one file.
    """
    if written.resolve() == mesh.resolve():
        raise OutputError(
            f"{mesh}: would be overwritten by {by}; another place is required; {remedy}"
        )


def require_folder(out: Path) -> None:
    """Refuse a folder for output that cannot be written, before anything is computed.

    Raises
    ------
    OutputError
        It or a folder above is a file, or may not be written.
    """
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise OutputError(f"{there}: is a file; a folder is required; name another place")
    if not os.access(there, os.W_OK | os.X_OK):
        raise OutputError(
            f"{there}: cannot be written; permission is required; name another place"
        )


def require_place(out: Path) -> None:
    """Refuse a file for output that is a folder, or whose folder cannot be written.

    Raises
    ------
    OutputError
        As said.
    """
    if out.is_dir():
        raise OutputError(f"{out}: is a folder; a file is required; name one in it")
    require_folder(out.parent)


def is_map(path: Path) -> bool:
    """Whether a file is a map by its name."""
    return path.suffix.lower() == ".npz"


def read_map(path: Path) -> SphericalMap:
    """Read a map, checked; its other arrays are kept in `arrays`.

    Raises
    ------
    UnreadableMesh
        No such file, a mesh, no npz, or arrays that are no spherical map.
    """
    if path.is_dir():
        raise UnreadableMesh(
            f"{path}: is a folder; one map, an npz, is required; name a file in it"
        )
    if not path.is_file():
        raise UnreadableMesh(
            f"{path}: does not exist; a map is required; write it with gensp parameterize"
        )
    _require_no_twin(path)
    if path.suffix.lower() in FORMATS:
        raise UnreadableMesh(
            f"{path}: is a mesh; its map, an npz, is required; type: "
            f"{shlex.join(['gensp', 'parameterize', str(path)])}"
        )
    try:
        arrays = load_npz(path)
    except (OSError, DamagedFile) as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}); an npz with vertices, faces and "
            "sphere is required; write it with gensp parameterize"
        ) from error
    fault = map_fault(arrays)
    if fault:
        raise UnreadableMesh(f"{path}: {fault}; write it with gensp parameterize")
    return map_from(arrays, path.stem, kept=arrays)


def _require_no_twin(path: Path) -> None:
    """Refuse the PLY of a map with its npz beside: read as a mesh, it would be mapped anew."""
    arrays_of = path.with_suffix(".npz")
    if path.suffix.lower() == ".ply" and arrays_of.is_file() and is_earlier(path):
        raise UnreadableMesh(
            f"{path}: is the PLY of a map; the npz beside it is required; name {arrays_of}"
        )


def chosen_method(
    method: str | None, model: str | None, register: bool
) -> SphericalParameterization:
    """The method that the options name.

    Raises
    ------
    Unsupported
        Options that exclude each other, or an unknown name.
    """
    from gensp.methods.table import DEFAULT, per_shape

    if model is None:
        if register:
            raise Unsupported("--register: belongs to a model; --model is required; add it")
        return per_shape(method or DEFAULT)
    if method not in (None, "gensp"):
        raise Unsupported(
            f"--method {method} with --model: a model is a method of its own; only one of "
            "them is possible; leave one out"
        )
    from gensp.api import load

    return load(model, register=register or None)


def map_of(path: Path, method: SphericalParameterization | None) -> SphericalMap:
    """A map as it is read, or that of a mesh by a method.

    Raises
    ------
    BadMesh
        Neither, or the PLY of a map whose npz is what has the sphere.
    """
    if is_map(path):
        return read_map(path)
    _require_no_twin(path)
    assert method is not None
    mesh = sound_mesh(path)
    compile_announced()
    with progress(mesh.name):
        return method(mesh)
