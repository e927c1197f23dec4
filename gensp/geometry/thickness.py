"""Local thickness of a closed surface: the largest ball inside that touches it at a point."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from gensp.geometry.mesh import Mesh

_ROUNDS = 30  # balls shrink geometrically; on meshes of this project they rest after about ten
_REST = 1 - 1e-9


def medial_ball_radii(mesh: Mesh) -> Float[np.ndarray, " n"]:
    """Radii (n,) of the largest balls that touch the surface at its vertices from inside.

    No other vertex lies in them. Faces must look outward. A radius is at most half of the local
    thickness, and at most the radius of curvature of a convex place: small on limbs, on tips and
    along ridges. By shrinking balls (Ma, Bae and Choi 2012). Too small by up to 15 % on smooth
    meshes, at any size: a neighbour's depth is like its normal's error.
    """
    points, normals = mesh.vertices, mesh.vertex_normals
    tree = cKDTree(points)
    radii = np.full(len(points), np.ptp(points, axis=0).max())
    moving = np.flatnonzero(np.isfinite(normals).all(axis=1) & normals.any(axis=1))
    for _ in range(_ROUNDS):
        gap, other = tree.query(points[moving] - radii[moving, None] * normals[moving])
        inside = (gap < radii[moving] * _REST) & (other != moving)
        moving, other = moving[inside], other[inside]
        if not len(moving):
            break
        apart = points[moving] - points[other]
        height = np.einsum("ij,ij->i", normals[moving], apart)
        radii[moving] = np.einsum("ij,ij->i", apart, apart) / (2 * height)
    return radii
