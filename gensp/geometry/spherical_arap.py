"""As-rigid-as-possible maps to the sphere (Wang, Liu & Liu 2014, ARAP spherical parametrization).

    E(u, L) = Σ_t Σ_k ½ cot θ_k ‖(u_{k+2} − u_{k+1}) − L_t (x_{k+2} − x_{k+1})‖²,  ‖u_i‖ = 1,

with an orthonormal frame L_t (3×2) for every triangle and its corners x in its own plane. Frames
and positions are found in turn (local/global). Nothing in it keeps triangles from folding.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import cotangent_laplacian, lumped_mass
from gensp.geometry.sphere import unit


@dataclass(frozen=True)
class RigidMap:
    """Unit positions (n, 3), the energy E, and how the iteration ended."""

    sphere: Float[np.ndarray, "n 3"]
    energy: float
    iterations: int
    converged: bool


class RigidityEnergy:
    """E of maps of one surface to the unit sphere.

    Parameters
    ----------
    mesh
        The surface, at the sphere's area 4π.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.faces, self.count = mesh.faces, len(mesh.vertices)
        edges = _edges(mesh.vertices, mesh.faces)
        dots = -np.einsum("mki,mki->mk", edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
        self.weights = dots / (4 * mesh.face_areas[:, None])  # half the cotangent at corner k
        first = unit(edges[:, 0])
        second = np.cross(mesh.face_normals, first)
        self.rest = np.stack(
            [np.einsum("mki,mi->mk", edges, axis) for axis in (first, second)], axis=2
        )

    def frames(self, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3 2"]:
        """The frames L_t that lie best on the triangles of u (local step)."""
        weighted = self.weights[:, :, None] * _edges(u, self.faces)
        left, _, right = np.linalg.svd(weighted.swapaxes(1, 2) @ self.rest, full_matrices=False)
        return left @ right

    def energy(self, u: Float[np.ndarray, "n 3"], frames: Float[np.ndarray, "m 3 2"]) -> float:
        """E(u, L)."""
        apart = _edges(u, self.faces) - self.rest @ frames.swapaxes(1, 2)
        return float(np.sum(self.weights * np.einsum("mki,mki->mk", apart, apart)))

    def pull(self, frames: Float[np.ndarray, "m 3 2"]) -> Float[np.ndarray, "n 3"]:
        """Right side b of the positions' system K u = b for given frames (global step)."""
        wanted = self.weights[:, :, None] * (self.rest @ frames.swapaxes(1, 2))
        corner = wanted[:, [1, 2, 0]] - wanted[:, [2, 0, 1]]
        corners, values = self.faces.reshape(-1), corner.reshape(-1, 3)
        return np.stack([np.bincount(corners, v, self.count) for v in values.T], axis=1)


def _edges(x: Float[np.ndarray, "n 3"], faces: np.ndarray) -> Float[np.ndarray, "m 3 3"]:
    """Edge k of every triangle, from corner k + 1 to corner k + 2."""
    corners = x[faces]
    return corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]


def rigid_map(
    mesh: Mesh,
    start: Float[np.ndarray, "n 3"],
    *,
    attraction: float = 10.0,
    max_iterations: int = 200,
    tolerance: float = 1e-5,
) -> RigidMap:
    """Minimise E from a start by turns of frames, positions and sphere.

    The positions of a turn minimise E for fixed frames plus λ Σ_i M_i ‖u_i − û_i‖², û the turn
    before and M the vertex areas. The best sphere is then fitted to them and they are projected.

    Parameters
    ----------
    mesh
        The surface, at total area 4π.
    attraction
        λ, how strongly the positions are held near the sphere while they move.
    tolerance
        Relative change of E to stop at.
    """
    rigidity, mass = RigidityEnergy(mesh), lumped_mass(mesh.vertices, mesh.faces)
    held = attraction * mass
    solver = SPDSolver(cotangent_laplacian(mesh) + sp.diags(held, format="csc"), mesh.vertices)
    u = unit(start)
    frames = rigidity.frames(u)
    energy = rigidity.energy(u, frames)
    for iteration in range(max_iterations):
        moved = solver.solve(rigidity.pull(frames) + held[:, None] * u)
        u = unit(moved - sphere_centre(moved, mass))
        frames, before = rigidity.frames(u), energy
        energy = rigidity.energy(u, frames)
        if abs(before - energy) <= tolerance * before:
            return RigidMap(u, energy, iteration + 1, True)
    return RigidMap(u, energy, max_iterations, False)


def sphere_centre(
    points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 3"]:
    """Centre c of the sphere that fits points best, Σ w (‖x − c‖² − r²)² being least."""
    rows = np.column_stack([2 * points, np.ones(len(points))])
    scale = np.sqrt(weights)
    squares = np.sum(points**2, axis=1)
    return np.linalg.lstsq(rows * scale[:, None], squares * scale, rcond=None)[0][:3]
