"""What is wrong with a mesh that should be one closed genus-0 surface, counted."""

import math
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from gensp.errors import BadMesh
from gensp.geometry.mesh import MAX_FACES, Mesh, require_genus_zero, signed_volume
from gensp.geometry.topology import edge_counts, half_edges, known_faces

_SINGULAR = {
    "vertices": "vertex",
    "edges": "edge",
    "faces": "face",
    "holes": "hole",
    "parts": "part",
}
REPAIR, REMESH = "gensp repair", "gensp repair --remesh"
LARGEST_HOLE = 1.0  # diagonals: longer rims are closed only where that is asked for


@dataclass(frozen=True)
class Diagnosis:
    """Counts of everything that can keep a mesh from the sphere.

    Attributes
    ----------
    not_finite, out_of_range
        Vertices that are not numbers; faces that name vertices which do not exist.
    degenerate_faces, duplicate_faces
        Triangles without area; triangles that repeat another's corners.
    duplicate_vertices, unused_vertices
        Vertices at another's position; vertices without a face.
    boundary_edges, holes
        Edges with one face; closed loops of them.
    longest_rim
        Length of the longest loop once vertices at one place are merged, in diagonals.
    nonmanifold_edges, nonmanifold_vertices
        Edges with more than two faces; vertices whose faces are several fans.
    misoriented_edges
        Edges that their two faces run through in the same direction.
    components
        Parts that are connected through edges.
    genus
        Handles, with every hole closed; None where that means nothing.
    inward
        The faces look inwards.
    max_faces
        So many faces are taken.
    complaint
        What `require_genus_zero` says; empty if the mesh can be used.
    """

    name: str
    vertices: int
    faces: int
    not_finite: int = 0
    out_of_range: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    duplicate_vertices: int = 0
    unused_vertices: int = 0
    boundary_edges: int = 0
    holes: int = 0
    longest_rim: float = 0.0
    nonmanifold_edges: int = 0
    nonmanifold_vertices: int = 0
    misoriented_edges: int = 0
    components: int = 0
    genus: int | None = None
    inward: bool = False
    max_faces: int = MAX_FACES
    complaint: str = ""

    @property
    def usable(self) -> bool:
        """Whether the mesh can be parameterized as it is."""
        return not self.complaint

    @property
    def too_large(self) -> bool:
        """Whether the mesh has more faces than are taken."""
        return self.faces > self.max_faces

    @property
    def findings(self) -> list[tuple[str, str]]:
        """Every finding with its remedy, the gravest first."""
        rows = [(count, words, remedy) for count, words, remedy in self._table() if count]
        told = [(counted(count, words), remedy) for count, words, remedy in rows]
        if self.genus:
            told.append((f"genus {self.genus}", REMESH))
        if self.inward:
            told.append(("faces look inwards", REPAIR))
        if not told and not self.usable:
            # What no count tells: too few faces.
            told.append((_bare(self.complaint), REMESH))
        return told

    def _table(self) -> list[tuple[int, str, str]]:
        parts = self.components if self.components > 1 else 0
        size = self.faces if self.too_large else 0
        return [
            (size, f"faces (at most {self.max_faces} are taken)", REMESH),
            (self.not_finite, "non-finite vertices", REPAIR),
            (self.out_of_range, "faces with missing vertices", "export again"),
            (self.duplicate_vertices, "duplicate vertices", REPAIR),
            (self.degenerate_faces, "faces without area", REPAIR),
            (self.duplicate_faces, "duplicate faces", REPAIR),
            (self.nonmanifold_edges, "non-manifold edges", REPAIR),
            (self.nonmanifold_vertices, "non-manifold vertices", REPAIR),
            (self.boundary_edges, f"boundary edges in {counted(self.holes, 'holes')}", REPAIR),
            (self.misoriented_edges, "misoriented edges", REPAIR),
            (parts, "components", REPAIR),
            (self.unused_vertices, "vertices without a face", REPAIR),
        ]


def diagnose(mesh: Mesh, *, max_faces: int = MAX_FACES) -> Diagnosis:
    """Count what is wrong with a mesh; never raises for what it finds."""
    known = known_faces(mesh.faces, len(mesh.vertices))
    finite = np.isfinite(mesh.vertices).all(axis=1)
    sound = np.where(finite[:, None], mesh.vertices, 0.0)
    part = Mesh(sound, mesh.faces[known], mesh.name)
    counts = _counts(part) if len(part.faces) else {}
    return Diagnosis(
        name=mesh.name,
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        not_finite=int((~finite).sum()),
        out_of_range=int((~known).sum()),
        duplicate_vertices=len(sound) - len(np.unique(mesh.vertices, axis=0)),
        unused_vertices=len(sound) - len(np.unique(part.faces)),
        max_faces=max_faces,
        complaint=_complaint(mesh, max_faces),
        **counts,
    )


def repair_command(path: Path, found: Diagnosis) -> str:
    """What to type to mend a file with these findings."""
    words = ["gensp", "repair", str(path), f"{path.stem}_mended.ply"]
    if any(remedy == REMESH for _, remedy in found.findings):
        words.append("--remesh")
        words += ["--vertices", str(_fewer(found.max_faces))] if found.too_large else []
    elif found.longest_rim > LARGEST_HOLE:
        words += ["--largest-hole", enough(found.longest_rim)]
    return shlex.join(words)


def _fewer(max_faces: int) -> int:
    """Vertices of a mesh with a fifth of the faces that are taken: it is mapped in seconds."""
    return max(100, max_faces // 10)


def enough(rim: float) -> str:
    """A limit that lets a rim of this length be closed, rounded up."""
    return f"{math.ceil(10 * rim + 0.1) / 10:g}"


def _complaint(mesh: Mesh, max_faces: int) -> str:
    try:
        require_genus_zero(mesh, max_faces=max_faces)
    except BadMesh as error:
        return str(error)
    return ""


def counted(count: int, words: str) -> str:
    """The number and its words, whose first noun comes in the plural."""
    for plural, singular in _SINGULAR.items():
        if count == 1 and plural in words:
            return f"1 {words.replace(plural, singular, 1)}"
    return f"{count} {words}"


def _bare(complaint: str) -> str:
    """What was found, without the mesh's name and the remedy."""
    return complaint.split(": ", 1)[-1].split(";")[0]


def _counts(mesh: Mesh) -> dict[str, Any]:
    degenerate = degenerate_faces(mesh)
    faces = mesh.faces[~degenerate]
    corners = np.unique(np.sort(faces, axis=1), axis=0)
    found: dict[str, Any] = {
        "degenerate_faces": int(degenerate.sum()),
        "duplicate_faces": len(faces) - len(corners),
        "components": int(igl.facet_components(mesh.faces)[0]),
    }
    if len(faces) == 0:
        return found
    edges = edge_counts(faces)
    loops = _loops(faces)
    rim = _longest_rim(Mesh(mesh.vertices, faces)) if loops else 0.0
    fans = int((~np.asarray(igl.is_vertex_manifold(faces)))[np.unique(faces)].sum())
    found |= {**edges, "holes": loops, "longest_rim": rim, "nonmanifold_vertices": fans}
    if edges["nonmanifold_edges"] == 0 and fans == 0:
        parts = int(igl.facet_components(faces)[0])
        # Every hole closed by a disc adds one to the Euler characteristic.
        closed = Mesh(mesh.vertices, faces).euler + loops
        found["genus"] = parts - closed // 2
        if edges["boundary_edges"] + edges["misoriented_edges"] == 0 and parts == 1:
            found["inward"] = signed_volume(Mesh(mesh.vertices, faces)) < 0
    return found


def degenerate_faces(mesh: Mesh, smallest: float = 1e-15) -> Bool[np.ndarray, " m"]:
    """Faces with a repeated corner, or with less than `smallest` of the total area."""
    repeated = (np.diff(np.sort(mesh.faces, axis=1), axis=1) == 0).any(axis=1)
    return repeated | (mesh.face_areas <= smallest * max(mesh.area, np.finfo(float).tiny))


def boundary_half_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "b 2"]:
    """Sides of faces that have no second face, in their face's direction."""
    sides = half_edges(faces)
    n = int(faces.max()) + 1
    undirected = sides.min(axis=1) * n + sides.max(axis=1)
    _, edge, count = np.unique(undirected, return_inverse=True, return_counts=True)
    return sides[count[edge.reshape(-1)] == 1]


def _longest_rim(mesh: Mesh) -> float:
    """In diagonals; vertices at one place count as one, because mending begins with that."""
    vertices, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    used = vertices[np.unique(place.reshape(-1)[mesh.faces])]
    rims = rim_lengths(Mesh(vertices, place.reshape(-1)[mesh.faces].astype(np.int64)))
    return float(rims.max(initial=0) / np.linalg.norm(np.ptp(used, axis=0)))


def rim_lengths(mesh: Mesh) -> Float[np.ndarray, " k"]:
    """Length of every hole's rim."""
    sides = boundary_half_edges(mesh.faces)
    _, label = boundary_labels(sides)
    lengths = np.linalg.norm(mesh.vertices[sides[:, 1]] - mesh.vertices[sides[:, 0]], axis=1)
    # Of nothing, bincount makes integers.
    return np.bincount(label, weights=lengths).astype(np.float64)


def _loops(faces: Int[np.ndarray, "m 3"]) -> int:
    """Connected sets of boundary edges."""
    return int(boundary_labels(boundary_half_edges(faces))[0])


def boundary_labels(
    sides: Int[np.ndarray, "b 2"],
) -> tuple[int, Int[np.ndarray, " b"]]:
    """Number of connected sets of edges, and the set of each."""
    if len(sides) == 0:
        return 0, np.zeros(0, dtype=np.int64)
    used, places = np.unique(sides, return_inverse=True)
    start, end = places.reshape(-1, 2).T
    graph = sp.csr_array((np.ones(len(start), bool), (start, end)), shape=(len(used),) * 2)
    count, label = connected_components(graph, directed=False)
    return int(count), label[start].astype(np.int64)
