"""A part of a mesh as a mesh of its own."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from gensp.geometry.mesh import Mesh


def tidy(mesh: Mesh) -> Mesh:
    """The mesh without vertices that no face uses; the order of the others is kept."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int64), mesh.name)


def kept(mesh: Mesh, keep: Bool[np.ndarray, " m"]) -> tuple[Mesh, int]:
    """The faces that are to be kept, tidy, and the number of the others."""
    return tidy(replace(mesh, faces=mesh.faces[keep])), int((~keep).sum())
