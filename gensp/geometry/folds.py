"""Folds of a closed triangulated surface that is no map: faces turned over on their surroundings.

On the sphere a fold is a face of the wrong orientation, decided exactly by
`gensp.geometry.predicates`. On a shape in space nothing says which side is right, so a fold is
told by its rim: it is a triangle, or a small patch of some, at all of whose edges the surface
turns back on itself. Creases are no folds, however sharp: the two sides of a fin or of a closed
mouth hang together around the end of the crease. A shape that is almost a sphere is also read
as a map.
"""

import numpy as np
import scipy.sparse as sp
from igl import triangle_triangle_adjacency
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import unit

# Normals of neighbours more than 140° apart: the second face leads back over the first.
_TURNED = float(np.cos(np.radians(140)))
# Of the area. A lens is cut in two by its rim, but neither half is a fold.
_LARGEST = 0.1
_SHELL = 0.1


def folded_faces(mesh: Mesh) -> Bool[np.ndarray, " m"]:
    """Faces of a closed manifold that are folded over onto their surroundings, or have no area.

    A face is folded where it is turned by more than 140° against two of its neighbours and by more
    than 90° against the third. So is a patch of less than a tenth of the area that comes off when
    the surface is cut along all edges where it turns by more than 140°; faces without a normal
    come off on their own. Of a shape within a tenth of a sphere's radius from that sphere, faces
    that look inwards are folds as well.

    Of 30 scanned heads, simplified to 2500 vertices, this flags one face each of three: all three
    oppose the scan's own normals. It does not see a face that its neighbours follow around, as on
    a spike.
    """
    normals = mesh.face_normals
    neighbours = np.asarray(triangle_triangle_adjacency(mesh.faces)[0], dtype=np.int64)
    agreement = np.einsum("mi,mki->mk", normals, normals[neighbours])
    ordered = np.sort(agreement, axis=1)
    turned = (ordered[:, 1] < _TURNED) & (ordered[:, 2] < 0)
    return turned | _cut_off(mesh, neighbours, agreement) | _inward(normalize(mesh))


def _cut_off(
    mesh: Mesh, neighbours: Int[np.ndarray, "m 3"], agreement: Float[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    """Faces of small patches with a rim of sharp edges all around."""
    flat: Bool[np.ndarray, " m"] = np.linalg.norm(mesh.face_normals, axis=1) == 0
    joined = (agreement > _TURNED) & ~flat[:, None] & ~flat[neighbours]
    face, side = np.nonzero(joined)
    shape = (len(mesh.faces), len(mesh.faces))
    graph = sp.csr_array((np.ones(len(face)), (face, neighbours[face, side])), shape)
    _, patch = connected_components(graph, directed=False)
    area = np.bincount(patch, weights=mesh.face_areas)
    return (area < _LARGEST * mesh.area)[patch]


def _inward(mesh: Mesh) -> Bool[np.ndarray, " m"]:
    """Bad faces of the map from a normalised shape to the sphere, if it is as good as one."""
    if np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() > _SHELL:
        return np.zeros(len(mesh.faces), dtype=bool)
    return bad_faces(unit(mesh.vertices), mesh.faces)
