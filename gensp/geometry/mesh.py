"""Triangle meshes: reading, checking, normalising, simplifying."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import igl
import numpy as np
import trimesh
from jaxtyping import Float, Int

from gensp.errors import DegenerateMesh, NotGenusZero, UnreadableMesh
from gensp.files import atomic_path
from gensp.geometry.formats import FORMATS as FORMATS
from gensp.geometry.formats import MAX_FACES as MAX_FACES
from gensp.geometry.topology import sphere_fault
from gensp.geometry.wavefront import read_obj

SPHERE_AREA = 4 * np.pi


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: positions (n, 3) in float64 and faces (m, 3) in int64."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    name: str = "mesh"

    def __repr__(self) -> str:
        sizes = f"{len(self.vertices)} vertices, {len(self.faces)} faces"
        return f"{type(self).__name__}({self.name!r}, {sizes})"

    @cached_property
    def face_areas(self) -> Float[np.ndarray, " m"]:
        """Area of every face."""
        return igl.doublearea(self.vertices, self.faces).reshape(-1) / 2

    @property
    def area(self) -> float:
        """Total area."""
        return float(self.face_areas.sum())

    @cached_property
    def face_normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit normals of the faces; zero where a face is degenerate."""
        return igl.per_face_normals(self.vertices, self.faces, np.zeros(3))

    @cached_property
    def vertex_normals(self) -> Float[np.ndarray, "n 3"]:
        """Area-weighted unit normals at the vertices."""
        return igl.per_vertex_normals(self.vertices, self.faces)

    @cached_property
    def edges(self) -> Int[np.ndarray, "e 2"]:
        """Undirected edges, each once."""
        return np.asarray(igl.edges(self.faces), dtype=np.int64)

    @property
    def euler(self) -> int:
        """Euler characteristic of the vertices in use: 2 for a sphere."""
        return len(np.unique(self.faces)) - len(self.edges) + len(self.faces)

    def with_vertices(self, vertices: Float[np.ndarray, "n 3"], name: str | None = None) -> "Mesh":
        """The same triangulation at other positions."""
        return Mesh(vertices, self.faces, self.name if name is None else name)


def load_mesh(path: Path | str) -> Mesh:
    """Read a ply, obj, off or stl file; the vertex order of the file is kept.

    An stl file names no shared vertices, so its identical corners are merged.

    Raises
    ------
    UnreadableMesh
        The file is missing, empty, damaged, of another format, or holds no triangles.
    """
    path = Path(path)
    if path.is_dir():
        raise UnreadableMesh(f"{path}: is a folder; one mesh is required; name a file in it")
    if path.suffix.lower() not in FORMATS:
        raise UnreadableMesh(
            f"{path}: format '{path.suffix}' is not read; one of {', '.join(FORMATS)} is "
            "required; convert the file"
        )
    if not path.is_file():
        raise UnreadableMesh(
            f"{path}: does not exist; a triangle mesh is required; correct the path"
        )
    if path.stat().st_size == 0:
        raise UnreadableMesh(
            f"{path}: is empty; a triangle mesh is required; remove or replace it"
        )
    try:
        vertices, faces = read_obj(path) if path.suffix.lower() == ".obj" else _read(path)
    # Readers of damaged files raise whatever their parser met; the file is at fault in each case.
    except Exception as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}: {str(error)[:80]}); a whole "
            f"{path.suffix[1:]} file is required; export it again"
        ) from error
    if len(faces) == 0:
        raise UnreadableMesh(f"{path}: holds no triangles; a triangle mesh is required")
    if path.suffix.lower() == ".stl":
        vertices, faces = _welded(vertices, faces)
    return Mesh(vertices, faces, path.stem)


def _read(path: Path) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    # From an open file: a picture that the mesh names is not looked for.
    with open(path, "rb") as file:
        loaded: Any = trimesh.load(
            file,
            file_type=path.suffix[1:].lower(),
            process=False,
            force="mesh",
            maintain_order=True,
        )
    vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    return vertices, np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3)


def _welded(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, "m 3"]]:
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return unique, inverse.reshape(-1)[faces].astype(np.int64)


def save_mesh(mesh: Mesh, path: Path | str) -> None:
    """Write a mesh in the format of the suffix, whole or not at all."""
    with atomic_path(path) as temporary:
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(temporary)


def require_genus_zero(mesh: Mesh, *, max_faces: int = MAX_FACES) -> None:
    """Check that a mesh is one closed, oriented, genus-0 manifold with sound triangles.

    Raises
    ------
    DegenerateMesh
        Too few or too many faces, coordinates that are not numbers, triangles without area.
    NotGenusZero
        Open, non-manifold, inconsistently oriented or inside-out, in several components, or of
        higher genus.
    """
    _require_sound_triangles(mesh, max_faces)
    fault = sphere_fault(mesh.faces, len(mesh.vertices))
    if fault:
        raise NotGenusZero(f"{mesh.name}: {fault.found}; {fault.required}; {fault.remedy}")
    if signed_volume(mesh) <= 0:
        raise NotGenusZero(
            f"{mesh.name}: the faces look inwards (signed volume {signed_volume(mesh):.3g}); "
            "outward orientation is required; flip all faces"
        )


def _require_sound_triangles(mesh: Mesh, max_faces: int) -> None:
    if len(mesh.faces) > max_faces:
        raise DegenerateMesh(
            f"{mesh.name}: {len(mesh.faces)} faces; at most {max_faces} are taken; simplify it, "
            "or raise max_faces"
        )
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise DegenerateMesh(
            f"{mesh.name}: a face names vertex {mesh.faces.max()} of {len(mesh.vertices)}; "
            f"indices within the vertex list are required; export it again"
        )
    if not np.isfinite(mesh.vertices).all():
        count = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
        raise DegenerateMesh(
            f"{mesh.name}: {count} vertices are not finite numbers; finite coordinates are "
            f"required; export it again"
        )
    if len(mesh.faces) < 4:
        raise DegenerateMesh(
            f"{mesh.name}: {len(mesh.faces)} faces; a closed surface has at least 4; replace it"
        )
    _require_area(mesh)


def _require_area(mesh: Mesh) -> None:
    repeated = (np.diff(np.sort(mesh.faces, axis=1), axis=1) == 0).any(axis=1)
    flat = repeated | (mesh.face_areas <= 1e-15 * max(mesh.area, np.finfo(float).tiny))
    if flat.any():
        raise DegenerateMesh(
            f"{mesh.name}: {int(flat.sum())} triangles without area (first: face "
            f"{int(np.argmax(flat))}); positive areas are required; remesh it"
        )


def signed_volume(mesh: Mesh) -> float:
    """Volume within a closed surface, negative where its faces look inwards."""
    centred = (mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces]
    return float(np.linalg.det(centred).sum() / 6)


def normalize(mesh: Mesh) -> Mesh:
    """Area-weighted centroid at the origin, total area 4π: the scale of the unit sphere."""
    weights = mesh.face_areas / mesh.area
    corners = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    centroid = weights @ sum(corners) / 3
    return replace(mesh, vertices=(mesh.vertices - centroid) * np.sqrt(SPHERE_AREA / mesh.area))


def simplify(mesh: Mesh, vertices: int) -> Mesh:
    """Decimate by edge collapses to about `vertices` vertices, keeping closedness and genus.

    Raises
    ------
    DegenerateMesh
        The collapses could not keep a closed genus-0 surface.
    """
    if len(mesh.vertices) <= vertices:
        return mesh
    target = 2 * vertices - 4
    positions, faces, *_ = igl.decimate(mesh.vertices, mesh.faces, target)
    coarse = Mesh(np.asarray(positions), np.asarray(faces, dtype=np.int64), mesh.name)
    require_genus_zero(coarse, max_faces=len(mesh.faces))
    return coarse
