"""What the commands read: sound meshes, maps, methods."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gensp.errors import NotGenusZero, UnreadableMesh, Unsupported
from gensp.geometry.diagnosis import diagnose
from gensp.geometry.mesh import Mesh, load_mesh
from gensp.geometry.spherical_map import SphericalMap, load_map
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
        raise NotGenusZero(
            f"{path}: {what}; one closed surface of genus 0 is required; type: "
            f"gensp repair {path} {path.stem}_mended.ply"
        )
    return mesh


def is_map(path: Path) -> bool:
    """Whether a file is a map by its name."""
    return path.suffix.lower() == ".npz"


def read_map(path: Path) -> SphericalMap:
    """Read a map, checked; its other arrays are kept in `arrays`.

    Raises
    ------
    UnreadableMesh
        No such file, no npz, or arrays that are no spherical map.
    """
    if not path.is_file():
        raise UnreadableMesh(
            f"{path}: does not exist; a map is required; write it with gensp parameterize"
        )
    try:
        map = load_map(path)
        with np.load(path, allow_pickle=False) as archive:
            extra = {k: archive[k] for k in set(archive.files) - {"vertices", "faces", "sphere"}}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise UnreadableMesh(
            f"{path}: cannot be read as a map ({type(error).__name__}); an npz with vertices, "
            "faces and sphere is required; write it with gensp parameterize"
        ) from error
    fault = _fault(map)
    if fault:
        raise UnreadableMesh(
            f"{path}: {fault}; a map has vertices (n, 3), faces (m, 3) and unit vectors sphere "
            "(n, 3); write it with gensp parameterize"
        )
    faces = np.ascontiguousarray(map.faces, dtype=np.int64)
    sphere, surface = (np.ascontiguousarray(x, dtype=float) for x in (map.sphere, map.surface))
    return replace(map, sphere=sphere, surface=surface, faces=faces, arrays=extra)


def _fault(map: SphericalMap) -> str:
    shapes = (map.surface.shape, map.sphere.shape, map.faces.shape)
    if any(len(s) != 2 or s[1] != 3 or s[0] == 0 for s in shapes) or shapes[0] != shapes[1]:
        return f"arrays of the shapes {', '.join(map_shape(s) for s in shapes)}"
    if not np.issubdtype(map.faces.dtype, np.integer):
        return f"faces of {map.faces.dtype}"
    if map.faces.min() < 0 or map.faces.max() >= len(map.sphere):
        return f"faces name vertices outside the {len(map.sphere)}"
    if not np.isfinite(map.surface).all():
        return "vertices that are not numbers"
    length = np.linalg.norm(map.sphere, axis=1)
    if not np.isfinite(length).all() or np.abs(length - 1).max() > 1e-6:
        return "sphere positions that are not unit vectors"
    return ""


def map_shape(shape: tuple[int, ...]) -> str:
    """A shape as numpy writes it."""
    return str(tuple(shape))


def chosen_method(
    method: str | None, checkpoint: Path | None, register: bool
) -> SphericalParameterization:
    """The method that the options name.

    Raises
    ------
    Unsupported
        Options that exclude each other, or an unknown name.
    """
    from gensp.methods.table import DEFAULT, per_shape

    if checkpoint is None:
        if register:
            raise Unsupported("--register: belongs to a model; --checkpoint is required; add it")
        return per_shape(method or DEFAULT)
    if method not in (None, "gensp"):
        raise Unsupported(
            f"--method {method} with --checkpoint: a model is a method of its own; only one of "
            "them is possible; leave one out"
        )
    from gensp.api import load

    return load(checkpoint, register=register)


def map_of(path: Path, method: SphericalParameterization | None) -> SphericalMap:
    """A map as it is read, or that of a mesh by a method."""
    if is_map(path):
        return read_map(path)
    assert method is not None
    return method(sound_mesh(path))
