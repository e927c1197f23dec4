"""Spherical maps by way of the plane: one triangle is removed, the rest is mapped inside it.

A reconstruction of Chen et al. 2025 from what is told of it: the open mesh is embedded in a
triangle of the plane, its composition with the inverse stereographic projection is optimised, and
the removed triangle becomes the one around the pole. Planar triangles stay free of folds; their
images between great circles need not be.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from gensp.errors import NotEmbeddable
from gensp.geometry.assembly import HessianPattern
from gensp.geometry.composed_dirichlet import ComposedDirichlet
from gensp.geometry.descent import minimised
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import adjacency, lumped_mass
from gensp.geometry.spherical_energy import project_positive

_RIDGE = 1e-6  # times the vertex areas on the sphere: holds the turns about the pole


@dataclass(frozen=True)
class PlanarMap:
    """Positions (n, 2) in the plane, their energy, and how the minimisation ended."""

    plane: Float[np.ndarray, "n 2"]
    energy: float
    iterations: int
    converged: bool


def faces_by_regularity(mesh: Mesh) -> Int[np.ndarray, " m"]:
    """Faces from the most equilateral on, by area over squared edge lengths."""
    corners = mesh.vertices[mesh.faces]
    squares = np.sum((corners[:, [1, 2, 0]] - corners) ** 2, axis=(1, 2))
    return np.argsort(-mesh.face_areas / squares, kind="stable")


def inverse_stereographic(z: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """From the plane to the unit sphere: the origin to the north pole, infinity to the south."""
    squares = np.sum(z**2, axis=1, keepdims=True)
    return np.concatenate([2 * z, 1 - squares], axis=1) / (1 + squares)


def tutte_in_triangle(mesh: Mesh, outer: int) -> Float[np.ndarray, "n 2"]:
    """Embed all faces but one inside an equilateral triangle, that one's corners at its own.

    Every other vertex is the mean of its neighbours, so no face folds (Tutte 1963). Cotangent
    weights would be nearly conformal and crowd limbs beyond what doubles resolve.
    """
    a, b, c = mesh.faces[outer]
    rim, angles = np.array([a, c, b]), 2 * np.pi / 3 * np.arange(3)
    z = np.zeros((len(mesh.vertices), 2))
    z[rim] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    inside = np.setdiff1d(np.arange(len(z)), rim)
    rows = adjacency(mesh.faces)[inside]
    laplacian = sp.diags(np.asarray(rows.sum(axis=1)).reshape(-1)) - rows[:, inside]
    z[inside] = SPDSolver(laplacian, mesh.vertices[inside]).solve(rows[:, rim] @ z[rim])
    return z


def balanced(
    z: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "m 3"], areas: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "n 2"]:
    """Shift and scale so that half of the area lies inside the unit circle, half outside.

    The circle is centred at the median of the area: a mean would follow the few large triangles
    at the rim. So both hemispheres receive the same area.
    """
    centroids = z[faces].mean(axis=1)
    centre = np.array([_weighted_median(x, areas) for x in centroids.T])
    return (z - centre) / _weighted_median(np.linalg.norm(centroids - centre, axis=1), areas)


def _weighted_median(x: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]) -> float:
    order = np.argsort(x)
    shares = np.cumsum(weights[order])
    return float(x[order[np.searchsorted(shares, shares[-1] / 2)]])


def planar_map(
    mesh: Mesh,
    outer: int,
    *,
    max_iterations: int = 200,
    tolerance: float = 1e-4,
) -> PlanarMap:
    """Minimise the composed symmetric Dirichlet energy over the mesh without one face.

    Projected Newton steps from the balanced Tutte embedding, with a line search that folds no
    planar triangle. The corners of the removed face move with the rest.

    Parameters
    ----------
    mesh
        A closed genus-0 mesh at total area 4π.
    outer
        The face that is removed.
    tolerance
        Relative decrease of the energy to stop at.

    Raises
    ------
    NotEmbeddable
        Rounding folds the embedding: it crowds triangles into a point.
    """
    rest, energy, z = _started(mesh, outer)
    if not np.isfinite(energy.energy(z)):
        raise NotEmbeddable(
            f"{mesh.name}: the planar embedding inside face {outer} crowds triangles until they "
            "fold; positive areas are required; remove another face"
        )
    found = minimised(_ComposedEnergy(rest, energy), z, max_iterations, relative=tolerance)
    return PlanarMap(found.positions, found.energy, found.iterations, found.converged)


def removable_face(mesh: Mesh, attempts: int = 30) -> int:
    """The most regular face inside which rounding folds no triangle of the embedding.

    Raises
    ------
    NotEmbeddable
        So many of the most regular faces were tried in vain.
    """
    for outer in faces_by_regularity(mesh)[:attempts].tolist():
        _, energy, z = _started(mesh, outer)
        if np.isfinite(energy.energy(z)):
            return int(outer)
    raise NotEmbeddable(
        f"{mesh.name}: the planar embedding crowds triangles until they fold, inside each of the "
        f"{attempts} most regular faces; positive areas are required; use another method, or "
        "remesh the shape"
    )


def _started(mesh: Mesh, outer: int) -> tuple[Mesh, ComposedDirichlet, Float[np.ndarray, "n 2"]]:
    """The mesh without a face, its energy, and its balanced embedding inside that face."""
    rest = Mesh(mesh.vertices, np.delete(mesh.faces, outer, axis=0), mesh.name)
    z = balanced(tutte_in_triangle(mesh, outer), rest.faces, rest.face_areas)
    return rest, ComposedDirichlet(rest), z


class _ComposedEnergy:
    """The energy of a planar map, with a ridge in its Hessian."""

    def __init__(self, mesh: Mesh, energy: ComposedDirichlet) -> None:
        self.points, self.energy = mesh.vertices, energy
        self.pattern = HessianPattern(mesh.faces, len(mesh.vertices))
        self.ridge = _RIDGE * lumped_mass(mesh.vertices, mesh.faces)

    def value(self, z: Float[np.ndarray, "n 2"]) -> float:
        return self.energy.energy(z)

    def derivatives(
        self, z: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, " k"], sp.csc_matrix]:
        gradient, blocks = self.energy.derivatives(z)
        ridge = self.ridge * 4 / (1 + np.sum(z**2, axis=1)) ** 2
        return gradient, self.pattern.assemble(project_positive(blocks), np.repeat(ridge, 2))

    def path(
        self, z: Float[np.ndarray, "n 2"], step: Float[np.ndarray, " k"]
    ) -> Callable[[float], Float[np.ndarray, "n 2"]]:
        return lambda part: z + part * step.reshape(-1, 2)

    def folds(self, z: Float[np.ndarray, "n 2"]) -> bool:
        return False
