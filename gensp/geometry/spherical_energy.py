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
from functools import cached_property

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from gensp.compiled.energies import ENERGIES, energy_slopes_of, energy_values_of
from gensp.geometry.mesh import Mesh

_PAIRS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # corners (u, v) of a pair and the corner opposite


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
        edges = _edges(_gathered(mesh.vertices, mesh.faces))
        dots = [-_dot(edges[(k + 1) % 3], edges[(k + 2) % 3]) for k in range(3)]
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
        return self._corner_sum @ corners.transpose(0, 2, 1).reshape(-1, 3)

    def hessians(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """Riemannian Hessian of every triangle's term, in the tangent coordinates of its corners.

        Moving along x means u ← (u + T x)/‖u + T x‖ = u + T x − ½|x|² u + …, which adds −(g·u) I
        to the block of a corner with gradient g.
        """
        terms = self._terms(u)
        slopes = self._slopes(terms)
        tangents = np.stack([_gathered(frames[:, :, k], self.faces) for k in (0, 1)], axis=1)
        blocks = self._gradient_products(terms, slopes, tangents)
        for pair in _PAIRS:
            first, second = (slice(2 * corner, 2 * corner + 2) for corner in pair[:2])
            block = self._pair_block(terms, slopes, tangents, *pair)
            blocks[first, second] += block
            blocks[second, first] += block.swapaxes(0, 1)
        normal = _dot(self._corner_gradients(terms, slopes), terms.corners)
        for k in range(3):
            stiff = slopes.stretch * (self.cotangents[(k + 1) % 3] + self.cotangents[(k + 2) % 3])
            blocks[[2 * k, 2 * k + 1], [2 * k, 2 * k + 1]] += stiff - normal[k]
        return blocks

    def _terms(self, u: Float[np.ndarray, "n 3"]) -> _Terms:
        corners = _gathered(u, self.faces)
        edges = _edges(corners)
        stretch = 0.5 * np.sum(self.cotangents * _dot(edges, edges), axis=0)
        # Differences first: the plain triple product loses the sign of very small triangles.
        ratio = _dot(corners[0], _cross(edges[1], edges[2])) / self.twice_areas
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
        return moved + slopes.determinant * _determinant_gradients(terms)

    def _gradient_products(
        self, terms: _Terms, slopes: _Slopes, tangents: Float[np.ndarray, "3 2 3 m"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """The rank-two part: products of the gradients of d and of the determinant."""
        stretch = _tangential(tangents, self._stretch_gradients(terms))
        determinant = _tangential(tangents, _determinant_gradients(terms))
        half = slopes.mixed * stretch + 0.5 * slopes.determinant_twice * determinant
        product = half[:, None] * determinant[None]
        if slopes.stretch_twice.any():
            product += 0.5 * (slopes.stretch_twice * stretch)[:, None] * stretch[None]
        return product + product.swapaxes(0, 1)

    def _pair_block(
        self,
        terms: _Terms,
        slopes: _Slopes,
        tangents: Float[np.ndarray, "3 2 3 m"],
        first: int,
        second: int,
        third: int,
    ) -> Float[np.ndarray, "2 2 m"]:
        """Mixed second derivatives of two corners: cotangent term plus det(t_u, t_v, u_w)."""
        linear = slopes.stretch * self.cotangents[third]
        across = _cross(tangents[second], terms.corners[third][None])
        moved = slopes.determinant * across - linear * tangents[second]
        return _dot(tangents[first][:, None], moved[None])

    @cached_property
    def _corner_sum(self) -> scipy.sparse.csr_matrix:
        corners = self.faces.T.reshape(-1)
        entries = (np.ones(len(corners)), (corners, np.arange(len(corners))))
        return scipy.sparse.csr_matrix(entries, shape=(self.count, len(corners)))


def _gathered(
    x: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3 3 m"]:
    return np.ascontiguousarray(x.T[:, faces.T].swapaxes(0, 1))


def _edges(corners: Float[np.ndarray, "3 3 m"]) -> Float[np.ndarray, "3 3 m"]:
    return corners[[2, 0, 1]] - corners[[1, 2, 0]]


def _dot(a: Float[np.ndarray, "*k 3 m"], b: Float[np.ndarray, "*l 3 m"]) -> np.ndarray:
    return np.sum(a * b, axis=-2)


def _cross(a: Float[np.ndarray, "*k 3 m"], b: Float[np.ndarray, "*l 3 m"]) -> np.ndarray:
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -2, 0), np.moveaxis(b, -2, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-2)


def _determinant_gradients(terms: _Terms) -> Float[np.ndarray, "3 3 m"]:
    return _cross(terms.corners[[1, 2, 0]], terms.corners[[2, 0, 1]])


def _tangential(
    tangents: Float[np.ndarray, "3 2 3 m"], gradients: Float[np.ndarray, "3 3 m"]
) -> Float[np.ndarray, "6 m"]:
    return _dot(tangents, gradients[:, None]).reshape(6, -1)


def project_positive(hessians: Float[np.ndarray, "6 6 m"]) -> Float[np.ndarray, "6 6 m"]:
    """Nearest positive semidefinite matrix of every 6×6 block (negative eigenvalues to zero)."""
    values, vectors = np.linalg.eigh(np.moveaxis(hessians, 2, 0))
    projected = (vectors * np.maximum(values, 0)[:, None]) @ vectors.swapaxes(1, 2)
    return np.ascontiguousarray(np.moveaxis(projected, 0, 2))


def triangle_weights(mesh: Mesh, floor: float) -> Float[np.ndarray, " m"]:
    """Factors w_t that let faces below `floor` of the mean area weigh as much as that.

    Weighed by their true area, the smallest faces take the largest distortion; weighed all alike
    (a large floor), a map follows the density of its mesh.
    """
    return np.maximum(1, floor * mesh.face_areas.mean() / mesh.face_areas)
