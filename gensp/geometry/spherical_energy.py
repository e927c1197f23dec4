"""Distortion energies of maps to the sphere: value, gradient, projected Hessians.

For a map u from a triangulated surface to the unit sphere,

    E(u) = Σ_t w_t A_t φ(D_t, j_t),

with A_t D_t = A_t‖J_t‖² = d_t = ½ Σ_k cot α_k |e_k|² over the chordal edges e_k, the area ratio
taken as j_t = det(u_a, u_b, u_c) / (2 A_t), and φ one of `energies.ENERGIES`. The determinant has
the sign of the *spherical* triangle, so the energy is a barrier against exactly the folds that the
predicates find. For small triangles it tends to det J_t. Projecting the Hessian element by element
follows Teran et al. 2005 (Robust quasistatic finite elements).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gensp.compiled.energies import ENERGIES, energy_slopes_of, energy_values_of
from gensp.compiled.projection import raise_negative
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_triangles import (
    curvature_blocks,
    determinant_gradients,
    determinants,
    dot,
    edges_of,
    gathered,
    gathered_frames,
    summed_at_vertices,
    tangential,
)


@dataclass(frozen=True)
class _Terms:
    """What value and derivatives share, at one position; triangles run along the last axis."""

    corners: Float[np.ndarray, "3 3 m"]  # corner, component
    edges: Float[np.ndarray, "3 3 m"]  # edge k is opposite to corner k
    stretch: Float[np.ndarray, " m"]  # d_t
    ratio: Float[np.ndarray, " m"]  # j_t


@dataclass(frozen=True)
class _Slopes:
    """Derivatives of a triangle's term by d and by the determinant; each (m,)."""

    stretch: Float[np.ndarray, " m"]
    determinant: Float[np.ndarray, " m"]
    stretch_twice: Float[np.ndarray, " m"]
    mixed: Float[np.ndarray, " m"]
    determinant_twice: Float[np.ndarray, " m"]


class SphericalEnergy:
    """Distortion energy of maps of one surface to the unit sphere.

    Parameters
    ----------
    mesh
        The surface, at area 4π where values are to compare with the sphere's own.
    weights
        Factor w_t of every triangle, one by default.
    energy
        Name of φ in `energies.ENERGIES`.
    """

    def __init__(
        self,
        mesh: Mesh,
        weights: Float[np.ndarray, " m"] | None = None,
        energy: str = "dirichlet",
    ) -> None:
        self.kind = ENERGIES[energy]
        self.faces = mesh.faces
        self.count = len(mesh.vertices)
        self.twice_areas = 2 * mesh.face_areas
        self.weights = np.ones(len(mesh.faces)) if weights is None else weights
        edges = edges_of(gathered(mesh.vertices, mesh.faces))
        dots = [-dot(edges[(k + 1) % 3], edges[(k + 2) % 3]) for k in range(3)]
        self.cotangents = np.stack(dots) / self.twice_areas

    def energy(self, u: Float[np.ndarray, "n 3"]) -> float:
        """E(u); infinite when a spherical triangle is folded or without area."""
        terms = self._terms(u)
        if not (terms.ratio > 0).all():
            return np.inf
        areas = self.twice_areas / 2
        return float(
            (self.weights * areas)
            @ energy_values_of(self.kind, terms.stretch / areas, terms.ratio)
        )

    def gradient(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Derivative of E by the positions u as free vectors of space."""
        terms = self._terms(u)
        corners = self._corner_gradients(terms, self._slopes(terms))
        return summed_at_vertices(corners, self.faces, self.count)

    def hessians(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """Riemannian Hessian of every triangle's term, in the tangent coordinates of its corners.

        Moving along x means u ← (u + T x)/‖u + T x‖ = u + T x − ½|x|² u + …, which adds −(g·u) I
        to the block of a corner with gradient g.
        """
        terms = self._terms(u)
        slopes = self._slopes(terms)
        tangents = gathered_frames(frames, self.faces)
        blocks = self._gradient_products(terms, slopes, tangents)
        pulled = 0.5 * slopes.stretch * self.cotangents
        gradients = self._corner_gradients(terms, slopes)
        blocks += curvature_blocks(terms.corners, tangents, pulled, slopes.determinant, gradients)
        return blocks

    def _terms(self, u: Float[np.ndarray, "n 3"]) -> _Terms:
        corners = gathered(u, self.faces)
        edges = edges_of(corners)
        stretch = 0.5 * np.sum(self.cotangents * dot(edges, edges), axis=0)
        ratio = determinants(corners, edges) / self.twice_areas
        return _Terms(corners, edges, stretch, ratio)

    def _slopes(self, terms: _Terms) -> _Slopes:
        areas, w = self.twice_areas / 2, self.weights
        fd, fj, fdd, fdj, fjj = energy_slopes_of(self.kind, terms.stretch / areas, terms.ratio)
        return _Slopes(
            stretch=w * fd,
            determinant=w * fj / 2,
            stretch_twice=w * fdd / areas,
            mixed=w * fdj / (2 * areas),
            determinant_twice=w * fjj / (4 * areas),
        )

    def _stretch_gradients(self, terms: _Terms) -> Float[np.ndarray, "3 3 m"]:
        pulled = self.cotangents[:, None] * terms.edges
        return pulled[[1, 2, 0]] - pulled[[2, 0, 1]]

    def _corner_gradients(self, terms: _Terms, slopes: _Slopes) -> Float[np.ndarray, "3 3 m"]:
        moved = slopes.stretch * self._stretch_gradients(terms)
        return moved + slopes.determinant * determinant_gradients(terms.corners)

    def _gradient_products(
        self, terms: _Terms, slopes: _Slopes, tangents: Float[np.ndarray, "3 2 3 m"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """The rank-two part: products of the gradients of d and of the determinant."""
        stretch = tangential(tangents, self._stretch_gradients(terms))
        determinant = tangential(tangents, determinant_gradients(terms.corners))
        half = slopes.mixed * stretch + 0.5 * slopes.determinant_twice * determinant
        product = half[:, None] * determinant[None]
        if slopes.stretch_twice.any():
            product += 0.5 * (slopes.stretch_twice * stretch)[:, None] * stretch[None]
        return product + product.swapaxes(0, 1)


def project_positive(hessians: Float[np.ndarray, "6 6 m"]) -> Float[np.ndarray, "6 6 m"]:
    """Nearest positive semidefinite matrix of every 6×6 block (negative eigenvalues to zero).

    Raises
    ------
    numpy.linalg.LinAlgError
        A block has no eigenvalues: its entries are no numbers.
    """
    projected = np.array(hessians, order="C")
    if not raise_negative(projected):
        raise np.linalg.LinAlgError(
            "a triangle's Hessian cannot be diagonalised: its values are not finite"
        )
    return projected


def triangle_weights(mesh: Mesh, floor: float) -> Float[np.ndarray, " m"]:
    """Factors w_t that let faces below `floor` of the mean area weigh as much as that.

    Weighed by their true area, the smallest faces take the largest distortion; weighed all alike
    (a large floor), a map follows the density of its mesh.
    """
    return np.maximum(1, floor * mesh.face_areas.mean() / mesh.face_areas)
