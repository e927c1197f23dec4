"""Half-edge collapses of a closed genus-0 surface down to a tetrahedron.

The order is that of quadric error (Garland & Heckbert 1997) at the vertex that stays: flat regions
go first, tips of protrusions last, so that protrusions get their part of the sphere early (as in
Hu, Fu & Liu 2017 and Schmidt et al. 2023). Two priorities are known:

- `quadric`: planes weighed by area; at once short edges, well shaped triangles, low valence.
- `smat`: planes weighed alike plus 10⁻⁶/(smallest area after the move)² at total area 1, in
  independent sets (Schmidt et al. 2023).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from gensp.compiled.collapses import BASE, collapse_all
from gensp.errors import NotEmbeddable
from gensp.geometry.mesh import Mesh

Priority = Literal["quadric", "smat"]


@dataclass(frozen=True)
class HalfEdges:
    """Connectivity of a closed oriented triangulation with n vertices and h half-edges.

    Attributes
    ----------
    origin, twin
        Vertex that every half-edge leaves (h,), and the half-edge against it (h,).
    leaving
        One half-edge that leaves every vertex (n,).
    """

    origin: Int[np.ndarray, " h"]
    twin: Int[np.ndarray, " h"]
    leaving: Int[np.ndarray, " n"]

    @classmethod
    def of(cls, faces: Int[np.ndarray, "m 3"], count: int) -> "HalfEdges":
        """Half-edges of a closed manifold with `count` vertices."""
        origin = np.ascontiguousarray(faces.reshape(-1))
        tip = np.ascontiguousarray(faces[:, [1, 2, 0]].reshape(-1))
        key, against = origin * count + tip, tip * count + origin
        order = np.argsort(key)
        twin = order[np.searchsorted(key, against, sorter=order)]
        leaving = np.empty(count, dtype=np.int64)
        leaving[origin] = np.arange(len(origin))
        return cls(origin.copy(), twin, leaving)


@dataclass(frozen=True)
class Collapses:
    """A surface collapsed to a tetrahedron.

    Attributes
    ----------
    halfedges
        Connectivity of the tetrahedron, ready to be split.
    order
        The collapsed half-edges (n - 4,), in the order of the collapses.
    base
        The four vertices that are left.
    sizes
        Numbers of vertices that were left after every independent set, the last one first; only
        the tetrahedron's where the priority makes no sets.
    """

    halfedges: HalfEdges
    order: Int[np.ndarray, " k"]
    base: Int[np.ndarray, " 4"]
    sizes: tuple[int, ...]


def decimate(mesh: Mesh, priority: Priority = "quadric") -> Collapses:
    """Collapse a closed genus-0 mesh of sound triangles to a tetrahedron.

    Raises
    ------
    NotEmbeddable
        No collapse is allowed, though more than four vertices are left.
    """
    halfedges = HalfEdges.of(mesh.faces, len(mesh.vertices))
    independent = priority == "smat"
    shape = mesh.with_vertices(mesh.vertices / np.sqrt(mesh.area)) if independent else mesh
    order, sets = collapse_all(
        shape.vertices,
        quadrics(shape, np.ones(len(mesh.faces)) if independent else shape.face_areas),
        halfedges.origin,
        halfedges.twin,
        halfedges.leaving,
        independent,
    )
    left = len(mesh.vertices) - len(order)
    if left > BASE:
        raise NotEmbeddable(
            f"{mesh.name}: {left} vertices are left that no collapse can remove; a closed genus-0 "
            "triangulation is required; see what `gensp check` says of it"
        )
    gone = np.zeros(len(mesh.vertices), dtype=bool)
    gone[halfedges.origin[order]] = True
    sizes = len(mesh.vertices) - np.cumsum(np.bincount(sets))
    return Collapses(halfedges, order, np.flatnonzero(~gone), tuple(sizes[::-1].tolist()))


def quadrics(mesh: Mesh, weights: Float[np.ndarray, " m"]) -> Float[np.ndarray, "n 10"]:
    """Per vertex the coefficients of Σ_f w_f (n·x − d)² over its faces (Garland & Heckbert 1997).

    In the order xx, xy, xz, yy, yz, zz, x, y, z, 1; mixed squares are given once.
    """
    n, corner = mesh.face_normals, mesh.vertices[mesh.faces[:, 0]]
    d = np.einsum("mi,mi->m", n, corner)
    squares = n[:, [0, 0, 0, 1, 1, 2]] * n[:, [0, 1, 2, 1, 2, 2]]
    planes = np.column_stack([squares, -2 * d[:, None] * n, d**2]) * weights[:, None]
    result = np.zeros((len(mesh.vertices), 10))
    for k in range(3):
        np.add.at(result, mesh.faces[:, k], planes)
    return result
