"""Files of other authors' programs: the mesh that they read, the sphere positions that they write.

| suffix | mesh | sphere positions |
|---|---|---|
| .ply | binary, doubles x, y, z | vertex properties px, py, pz (Kazhdan's programs) |
| .obj | v and f lines, all digits | the vertices themselves (embedding of Schmidt et al.) |
| .m | Vertex and Face lines | strings sph=(x y z) of the vertices (Hoppe's programs) |
"""

import re
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from gensp.errors import UnreadableMesh
from gensp.geometry.mesh import Mesh
from gensp.geometry.ply import ply_bytes
from gensp.geometry.sphere import unit
from gensp.geometry.wavefront import read_obj

SUFFIXES = (".ply", ".obj", ".m")
_M_VERTEX = re.compile(r'^Vertex\s+(\d+)\s[^\n]*\bsph=[("]\s*([^)"]*)[)"]', re.MULTILINE)


def write_for_program(mesh: Mesh, path: Path) -> None:
    """Write a mesh in the format of the suffix, every digit kept.

    Raises
    ------
    UnreadableMesh
        A suffix that is none of the three.
    """
    if path.suffix == ".ply":
        path.write_bytes(ply_bytes("xyz", mesh.vertices, mesh.faces))
        return
    _require_suffix(path)
    obj = path.suffix == ".obj"
    corners = mesh.faces + 1
    with open(path, "w", encoding="ascii") as file:
        vertex, face = ("v", "f") if obj else ("Vertex %d ", "Face %d ")
        vertices = mesh.vertices if obj else _numbered(mesh.vertices)
        faces = corners if obj else _numbered(corners)
        np.savetxt(file, vertices, f"{vertex} %.17g %.17g %.17g")
        np.savetxt(file, faces, f"{face} %d %d %d")


def _numbered(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.arange(1, len(rows) + 1), rows])


def read_sphere_positions(path: Path, vertices: int) -> Float[np.ndarray, "n 3"]:
    """Unit positions of a mesh's vertices, in the order in which the mesh was written.

    Raises
    ------
    UnreadableMesh
        The file is missing or holds no positions, positions for other than so many vertices, or
        positions without direction.
    """
    _require_suffix(path)
    if not path.is_file() or path.stat().st_size == 0:
        found = "is empty" if path.is_file() else "was not written"
        raise UnreadableMesh(f"{path.name}: {found}; a file with sphere positions is required")
    readers = {".ply": _read_ply, ".obj": lambda path: read_obj(path)[0], ".m": _read_m}
    try:
        positions = readers[path.suffix](path)
    # Readers of damaged files raise whatever their parser met.
    except Exception as error:
        raise UnreadableMesh(
            f"{path.name}: cannot be read ({type(error).__name__}: {str(error)[:80]}); a whole "
            f"{path.suffix[1:]} file with sphere positions is required"
        ) from error
    lengths = np.linalg.norm(positions, axis=1)
    sound = int((np.isfinite(lengths) & (lengths > 0)).sum())
    if len(positions) != vertices or sound != vertices:
        raise UnreadableMesh(
            f"{path.name}: {sound} sound sphere positions of {len(positions)}; one for each of "
            f"the {vertices} vertices is required"
        )
    return unit(positions)


def _require_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise UnreadableMesh(
            f"{path.name}: format '{path.suffix}' is not exchanged with other programs; one of "
            f"{', '.join(SUFFIXES)} is required"
        )


def _read_ply(path: Path) -> Float[np.ndarray, "n 3"]:
    loaded = trimesh.load(path, process=False, maintain_order=True)
    data = loaded.metadata["_ply_raw"]["vertex"]["data"]
    columns = [np.asarray(data[name], dtype=np.float64).reshape(-1) for name in ("px", "py", "pz")]
    return np.stack(columns, axis=1)


def _read_m(path: Path) -> Float[np.ndarray, "n 3"]:
    text = path.read_text(encoding="utf-8", errors="replace")
    found = {int(number): words.split() for number, words in _M_VERTEX.findall(text)}
    return np.array([found[number] for number in sorted(found)], dtype=np.float64).reshape(-1, 3)
