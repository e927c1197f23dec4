"""As-rigid-as-possible deformation: best local rotations, energy, and its linear system.

Source: paper Eq. 2; Sorkine and Alexa 2007, "As-rigid-as-possible surface modeling".
"""

from typing import Literal

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import adjacency, clamped_laplacian, weighted_laplacian


def deformation_energy(
    p: Float[np.ndarray, "n 3"], q: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> float:
    """Deformation between two poses p, q of one triangulation (paper Eq. 2).

    Σ_i min_{R_i ∈ SO(3)} Σ_{j ∈ N_i} ‖R_i (p_i − p_j) − (q_i − q_j)‖², unweighted, so every edge
    counts once from each end. Zero for rigid motions, (s − 1)² Σ‖p_i − p_j‖² for a scaling by s.
    """
    return ArapSystem(Mesh(p, faces), weights="uniform").energy(q)


class ArapSystem:
    """Local and global step of E(x) = Σ_i min_{R_i} Σ_{j ∈ N_i} w_ij ‖R_i e_ij − (x_i − x_j)‖².

    e_ij = p_i − p_j are the edges of the rest shape; E counts every edge from both ends. For fixed
    rotations E is stationary where `laplacian` @ x = `rhs`(R): its gradient is
    4 (laplacian @ x − rhs).

    Parameters
    ----------
    rest
        The undeformed shape p.
    weights
        Cotangents (clamped to be positive), or one for every edge.

    Attributes
    ----------
    laplacian
        Sparse (n, n), positive semidefinite, kernel the constants.
    edge_energy
        Σ_i Σ_{j ∈ N_i} w_ij ‖e_ij‖²: the energy of collapsing the shape to a point.
    """

    def __init__(self, rest: Mesh, weights: Literal["cotangent", "uniform"] = "cotangent") -> None:
        self._size = len(rest.vertices)
        self.laplacian = _laplacian(rest, weights)
        off = sp.coo_matrix(self.laplacian)
        kept = off.row != off.col
        self._i, self._j, self._w = off.row[kept], off.col[kept], -off.data[kept]
        self._rest = rest.vertices[self._i] - rest.vertices[self._j]
        self.edge_energy = float(self._w @ np.sum(self._rest**2, axis=1))
        self._covariance = sp.vstack(
            [weighted_laplacian(self._i, self._j, self._w * e) for e in self._rest.T], format="csr"
        )

    def rotations(self, x: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Best rotation R_i of every 1-ring, from its covariance with the rest shape."""
        # Row b·n + i holds Σ_j w_ij e_ij[b] (x_i − x_j), the layout that libigl expects.
        stacked = igl.fit_rotations(self._covariance @ x)
        return np.ascontiguousarray(stacked.reshape(3, self._size, 3).transpose(1, 0, 2))

    def rhs(self, rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
        """Σ_j w_ij (R_i + R_j)/2 e_ij: what `laplacian` @ x equals at the optimum."""
        stacked = rotations.transpose(2, 0, 1).reshape(-1, 3)
        return (self._covariance.T @ stacked) / 2

    def energy(
        self,
        x: Float[np.ndarray, "n 3"],
        rotations: Float[np.ndarray, "n 3 3"] | None = None,
    ) -> float:
        """E at x, with the best rotations unless others are given."""
        if rotations is None:
            rotations = self.rotations(x)
        turned = np.einsum("kab,kb->ka", rotations[self._i], self._rest)
        residual = turned - (x[self._i] - x[self._j])
        return float(self._w @ np.sum(residual**2, axis=1))


def _laplacian(rest: Mesh, weights: str) -> sp.csc_matrix:
    if weights == "cotangent":
        return clamped_laplacian(rest)
    ring = sp.coo_matrix(adjacency(rest.faces))
    return weighted_laplacian(ring.row, ring.col, ring.data)
