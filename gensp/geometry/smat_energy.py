"""Energy of the sphere embedding of Schmidt et al. 2023: barrier, angles, areas.

Of every spherical triangle (Surface Maps via Adaptive Triangulations, §5, and its program),

    − log(det(u_a, u_b, u_c) / 6) − Σ log(140° − ℓ)               barrier, ℓ its three arcs
    + w_angle Σ (α/α₀)² + (α₀/α)²                                 its three corners
    + w_area (r² + r⁻²),   r = (chordal area / 4π) / (A / ΣA),

with α the corner angles between great circles and α₀, A the angles and the area on the surface.
All of it is a function f of the squared chords e_k = |u_{k+2} − u_{k+1}|² and the determinant D:
cos ℓ_k = 1 − e_k/2, and α_k is the argument of c_k + i D with

    c_k = u_{k+1}·u_{k+2} − (u_k·u_{k+1})(u_k·u_{k+2})
        = (e_{k+1} + e_{k+2} − e_k)/2 − e_{k+1} e_{k+2}/4.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gensp.geometry.mesh import SPHERE_AREA, Mesh
from gensp.geometry.spherical_triangles import (
    cross,
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

_LONGEST = np.deg2rad(140)
_OTHERS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


@dataclass(frozen=True)
class _Terms:
    """The invariants of the triangles at one position."""

    corners: Float[np.ndarray, "3 3 m"]
    edges: Float[np.ndarray, "3 3 m"]
    squares: Float[np.ndarray, "3 m"]  # e_k
    determinant: Float[np.ndarray, " m"]  # D
    cosines: Float[np.ndarray, "3 m"]  # c_k, cosines of the corners up to a factor
    sixteenfold: Float[np.ndarray, " m"]  # 16 (chordal area)²


class SmatEnergy:
    """Distortion energy of maps of one surface to the unit sphere; independent of its size.

    Parameters
    ----------
    mesh
        The surface, of sound triangles.
    barrier, angle, area
        Weights of the three terms; the authors' by default.
    """

    def __init__(
        self, mesh: Mesh, *, barrier: float = 1.0, angle: float = 100.0, area: float = 1.0
    ) -> None:
        self.faces, self.count = mesh.faces, len(mesh.vertices)
        self.barrier, self.angle, self.area = barrier, angle, area
        edges = edges_of(gathered(mesh.vertices, mesh.faces))
        twice = 2 * mesh.face_areas
        dots = [-dot(edges[(k + 1) % 3], edges[(k + 2) % 3]) for k in range(3)]
        self.angles = np.arctan2(twice, np.stack(dots))
        # r² is this times 16 (chordal area)².
        self.share = (mesh.face_areas.sum() / (4 * SPHERE_AREA * mesh.face_areas)) ** 2

    def energy(self, u: Float[np.ndarray, "n 3"]) -> float:
        """Sum over the triangles; infinite when one is folded, flat, or has an arc over 140°."""
        terms = self._terms(u)
        room = _LONGEST - _arcs(terms.squares)
        if not ((terms.determinant > 0).all() and (room > 0).all()):
            return np.inf
        ratio = np.arctan2(terms.determinant, terms.cosines) / self.angles
        grown = self.share * terms.sixteenfold
        with np.errstate(divide="ignore"):
            barrier = -np.log(terms.determinant / 6).sum() - np.log(room).sum()
            angle, area = (ratio**2 + ratio**-2.0).sum(), (grown + 1 / grown).sum()
        return float(self.barrier * barrier + self.angle * angle + self.area * area)

    def gradient(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Derivative of the energy by the positions u as free vectors of space."""
        terms = self._terms(u)
        slopes, _ = self._slopes(terms)
        corners = np.einsum("sm,skim->kim", slopes, _invariant_gradients(terms))
        return summed_at_vertices(corners, self.faces, self.count)

    def hessians(
        self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "n 3 2"]
    ) -> Float[np.ndarray, "6 6 m"]:
        """Riemannian Hessian of every triangle's term, in the tangent frames of its corners."""
        terms = self._terms(u)
        slopes, bends = self._slopes(terms)
        gradients = _invariant_gradients(terms)
        tangents = gathered_frames(frames, self.faces)
        jacobian = np.stack([tangential(tangents, gradient) for gradient in gradients], axis=1)
        jacobian = np.ascontiguousarray(jacobian.transpose(2, 0, 1))  # (m, 6, 4)
        product = jacobian @ bends.transpose(2, 0, 1) @ jacobian.swapaxes(1, 2)
        corners = np.einsum("sm,skim->kim", slopes, gradients)
        rest = curvature_blocks(terms.corners, tangents, slopes[:3], slopes[3], corners)
        return np.ascontiguousarray(product.transpose(1, 2, 0)) + rest

    def _terms(self, u: Float[np.ndarray, "n 3"]) -> _Terms:
        corners = gathered(u, self.faces)
        edges = edges_of(corners)
        normal = cross(edges[1], edges[2])
        e = dot(edges, edges)
        one, two = e[[1, 2, 0]], e[[2, 0, 1]]
        cosines = 0.5 * (one + two - e) - 0.25 * one * two
        return _Terms(
            corners, edges, e, determinants(corners, edges), cosines, 4 * dot(normal, normal)
        )

    def _slopes(
        self, terms: _Terms
    ) -> tuple[Float[np.ndarray, "4 m"], Float[np.ndarray, "4 4 m"]]:
        """First and second derivatives of f by (e_0, e_1, e_2, D)."""
        count = len(terms.determinant)
        slopes, bends = np.zeros((4, count)), np.zeros((4, 4, count))
        self._add_barrier(terms, slopes, bends)
        self._add_angles(terms, slopes, bends)
        self._add_area(terms, slopes, bends)
        return slopes, bends

    def _add_barrier(self, terms: _Terms, slopes: np.ndarray, bends: np.ndarray) -> None:
        e, d = terms.squares, terms.determinant
        slopes[3] -= self.barrier / d
        bends[3, 3] += self.barrier / d**2
        room, chord = _LONGEST - _arcs(e), e * (4 - e)
        turn = chord**-0.5  # dℓ/de
        slopes[:3] += self.barrier * turn / room
        bends[range(3), range(3)] += self.barrier * (
            (turn / room) ** 2 - (2 - e) * chord**-1.5 / room
        )

    def _add_angles(self, terms: _Terms, slopes: np.ndarray, bends: np.ndarray) -> None:
        e, d = terms.squares, terms.determinant
        for k, one, two in _OTHERS:
            c, rest = terms.cosines[k], self.angles[k]
            alpha, length = np.arctan2(d, c), d * d + c * c
            slope = 2 * self.angle * (alpha / rest**2 - rest**2 / alpha**3)
            bend = 2 * self.angle * (1 / rest**2 + 3 * rest**2 / alpha**4)
            by_c, by_d = -d / length, c / length
            # c_k as a function of (e_k, e_one, e_two), and α as one of all four.
            c_slopes = {k: np.full_like(d, -0.5), one: 0.5 - e[two] / 4, two: 0.5 - e[one] / 4}
            by = {index: by_c * part for index, part in c_slopes.items()} | {3: by_d}
            twice_c, mixed = -2 * by_c * by_d, (d * d - c * c) / length**2
            for i, first in by.items():
                slopes[i] += slope * first
                for j, second in by.items():
                    bends[i, j] += bend * first * second
            for i, first in c_slopes.items():
                for j, second in c_slopes.items():
                    bends[i, j] += slope * twice_c * first * second
                bends[i, 3] += slope * mixed * first
                bends[3, i] += slope * mixed * first
            bends[3, 3] -= slope * twice_c
            bends[one, two] -= slope * by_c / 4
            bends[two, one] -= slope * by_c / 4

    def _add_area(self, terms: _Terms, slopes: np.ndarray, bends: np.ndarray) -> None:
        e, h = terms.squares, terms.sixteenfold
        slope = self.area * (self.share - 1 / (self.share * h * h))
        bend = self.area * 2 / (self.share * h**3)
        by = 2 * (e[[1, 2, 0]] + e[[2, 0, 1]] - e)  # of Heron's formula for h
        slopes[:3] += slope * by
        bends[:3, :3] += bend * by[:, None] * by[None] + slope * _HERON[:, :, None]


_HERON = 2.0 - 4.0 * np.eye(3)  # second derivatives of 16 (area)² by the squared sides


def _arcs(squares: Float[np.ndarray, "3 m"]) -> Float[np.ndarray, "3 m"]:
    return 2 * np.arcsin(np.minimum(np.sqrt(squares) / 2, 1))


def _invariant_gradients(terms: _Terms) -> Float[np.ndarray, "4 3 3 m"]:
    """Derivatives of e_0, e_1, e_2 and D by the corners."""
    gradients = np.zeros((4, *terms.corners.shape))
    for k, one, two in _OTHERS:
        gradients[k, two] = 2 * terms.edges[k]
        gradients[k, one] = -2 * terms.edges[k]
    gradients[3] = determinant_gradients(terms.corners)
    return gradients
