"""Symmetric Dirichlet energy of a planar map followed by inverse stereographic projection.

The projection is conformal with factor λ(z) = 2/(1 + |z|²), so the composition of a planar map
with Jacobian J_t has the singular values λ σ_i(J_t). With λ at the triangle's centroid,

    E(z) = Σ_t A_t (λ_t² ‖J_t‖² + λ_t⁻² ‖J_t⁻¹‖²) = Σ_t d_t g(s_t, j_t),   g = q + 1/(q j²),

where d_t = ½ Σ_k cot α_k |e_k|², j_t = det J_t, s_t = |centroid|² and q = λ_t² = 4/(1 + s_t)².
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gensp.geometry.mesh import Mesh

_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # turns by 90° counter-clockwise


@dataclass(frozen=True)
class _Terms:
    """What value and derivatives share; triangles run along the last axis."""

    edges: Float[np.ndarray, "3 2 m"]  # edge k is opposite to corner k
    centroid: Float[np.ndarray, "2 m"]
    stretch: Float[np.ndarray, " m"]  # d_t
    ratio: Float[np.ndarray, " m"]  # j_t
    factor: Float[np.ndarray, " m"]  # q_t


class ComposedDirichlet:
    """E of planar maps of an open triangulation, with its derivatives.

    Parameters
    ----------
    mesh
        The surface, with the faces that are mapped to the plane, at the sphere's scale.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.faces, self.count = mesh.faces, len(mesh.vertices)
        self.twice_areas = 2 * mesh.face_areas
        corners = mesh.vertices[mesh.faces]
        edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
        dots = -np.einsum("mki,mki->km", edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
        self.cotangents = dots / self.twice_areas

    def energy(self, z: Float[np.ndarray, "n 2"]) -> float:
        """E(z); infinite when a planar triangle is folded or without area."""
        terms = self._terms(z)
        if not (terms.ratio > 0).all():
            return np.inf
        with np.errstate(over="ignore", divide="ignore"):
            return float(terms.stretch @ (terms.factor + 1 / (terms.factor * terms.ratio**2)))

    def derivatives(
        self, z: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "6 6 m"]]:
        """Gradient (2n,), and the Hessian of every triangle in its corners' coordinates."""
        terms = self._terms(z)
        stretch, ratio, centre = self._first(terms)
        g, g_s, g_j, g_ss, g_sj, g_jj = _slopes(terms)
        inner = g_s * centre + g_j * ratio
        local = (g * stretch + terms.stretch * inner).reshape(3, 2, -1)
        gradient = np.stack(
            [
                np.bincount(self.faces.T.reshape(-1), local[:, axis].reshape(-1), self.count)
                for axis in (0, 1)
            ],
            axis=1,
        )
        half = stretch[:, None] * inner[None] + terms.stretch * (
            0.5 * g_ss * centre[:, None] * centre[None]
            + g_sj * centre[:, None] * ratio[None]
            + 0.5 * g_jj * ratio[:, None] * ratio[None]
        )
        blocks = half + half.swapaxes(0, 1) + self._second(terms, g, g_s, g_j)
        return gradient.reshape(-1), blocks

    def _terms(self, z: Float[np.ndarray, "n 2"]) -> _Terms:
        corners = z.T[:, self.faces.T].swapaxes(0, 1)
        edges = corners[[2, 0, 1]] - corners[[1, 2, 0]]
        centroid = corners.sum(axis=0) / 3
        stretch = 0.5 * np.sum(self.cotangents * np.sum(edges**2, axis=1), axis=0)
        (ax, ay), (bx, by) = edges[1], edges[2]
        ratio = (ax * by - ay * bx) / self.twice_areas
        return _Terms(edges, centroid, stretch, ratio, 4 / (1 + np.sum(centroid**2, axis=0)) ** 2)

    def _first(self, terms: _Terms) -> list[Float[np.ndarray, "6 m"]]:
        """Gradients of d, j and s by the corners."""
        pulled = self.cotangents[:, None] * terms.edges
        stretch = pulled[[1, 2, 0]] - pulled[[2, 0, 1]]
        ratio = np.einsum("ij,kjm->kim", _QUARTER, terms.edges) / self.twice_areas
        centre = np.repeat(terms.centroid[None] * (2 / 3), 3, axis=0)
        return [gradient.reshape(6, -1) for gradient in (stretch, ratio, centre)]

    def _second(
        self,
        terms: _Terms,
        g: Float[np.ndarray, " m"],
        g_s: Float[np.ndarray, " m"],
        g_j: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, "6 6 m"]:
        """What the second derivatives of d, j and s, which are constants, add to the Hessian."""
        blocks = np.zeros((3, 2, 3, 2, len(g)))
        stiff, slope = g * self.cotangents, terms.stretch * g_j / self.twice_areas
        for axis in (0, 1):
            blocks[:, axis, :, axis] += terms.stretch * g_s * (2 / 9)
        for k, first, second in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            for axis in (0, 1):
                blocks[first, axis, first, axis] += stiff[k]
                blocks[second, axis, second, axis] += stiff[k]
                blocks[first, axis, second, axis] -= stiff[k]
                blocks[second, axis, first, axis] -= stiff[k]
            # det = Σ_k z_k × z_{k+1}: the cross product of the two corners is one of its terms.
            for (row, column), sign in (((0, 1), 1.0), ((1, 0), -1.0)):
                blocks[first, row, second, column] += sign * slope
                blocks[second, column, first, row] += sign * slope
        return blocks.reshape(6, 6, -1)


def _slopes(terms: _Terms) -> tuple[Float[np.ndarray, " m"], ...]:
    """G and its derivatives by s and j: g, g_s, g_j, g_ss, g_sj, g_jj."""
    q, j = terms.factor, terms.ratio
    root = np.sqrt(q) / 2  # 1/(1 + s)
    first, second = -8 * root**3, 24 * root**4
    inverse = 1 / (q * j) ** 2
    return (
        q + q * inverse,
        first * (1 - inverse),
        -2 / (q * j**3),
        second * (1 - inverse) + 2 * first**2 * inverse / q,
        2 * first * inverse / j,
        6 / (q * j**4),
    )
