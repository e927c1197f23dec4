"""Other triangles for the same surface, so that two meshes share no connectivity."""

import igl
import numpy as np

from gensp.geometry.mesh import Mesh, simplify

# Stretches of the space in which edges are collapsed: enough to choose other edges everywhere.
_STRETCH = (0.6, 1.7)


def retriangulate(mesh: Mesh, vertices: int, generator: np.random.Generator) -> Mesh:
    """About `vertices` vertices on the same surface, joined and numbered anew, by chance.

    Every face is cut in four, edges are collapsed by their length in a randomly stretched space,
    and vertices and faces are shuffled. A collapse ends in the middle of its edge, which an affine
    map keeps, so the stretch decides which edges go and moves nothing.

    Raises
    ------
    DegenerateMesh
        The collapses could not keep a closed genus-0 surface.
    """
    positions, faces = igl.upsample(mesh.vertices, mesh.faces)
    stretch = _affine(generator)
    fine = Mesh(np.asarray(positions) @ stretch, np.asarray(faces, dtype=np.int64), mesh.name)
    coarse = simplify(fine, vertices)
    return _shuffled(coarse.with_vertices(coarse.vertices @ np.linalg.inv(stretch)), generator)


def _affine(generator: np.random.Generator) -> np.ndarray:
    """A symmetric stretch along three random orthogonal axes."""
    axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    return axes * generator.uniform(*_STRETCH, size=3) @ axes.T


def _shuffled(mesh: Mesh, generator: np.random.Generator) -> Mesh:
    order = generator.permutation(len(mesh.vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    faces = place[mesh.faces][generator.permutation(len(mesh.faces))]
    return Mesh(mesh.vertices[order], np.ascontiguousarray(faces), mesh.name)
