"""One placement on the sphere for a surface that many shapes share (ours).

Where correspondences are known, a map of one shape is a map of all. What it should distort little
is their mean: the metric tensors of every triangle averaged over the shapes.
"""

import numpy as np
from jaxtyping import Float, Int

from gensp.compiled.energies import ENERGIES
from gensp.geometry.mesh import SPHERE_AREA, Mesh
from gensp.geometry.newton import Refined, minimise_map
from gensp.geometry.spherical_energy import SphericalEnergy

_FLAT = 1e-4  # of the mean area: what the mean metric counts as the least area of a triangle


def mean_squared_lengths(
    images: Float[np.ndarray, "k n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3 m"]:
    """Squared lengths of the edges opposite to the corners, averaged over shapes of area 4π.

    Averages of metrics are metrics: the triangle inequalities hold.
    """
    corners = images[:, faces]
    edges = corners[:, :, [2, 0, 1]] - corners[:, :, [1, 2, 0]]
    mean: np.ndarray = np.square(edges).sum(axis=3).mean(axis=0).T
    return mean


class MetricEnergy(SphericalEnergy):
    """Distortion energy of maps of a triangulation that is known by its edge lengths alone.

    Parameters
    ----------
    squared
        Squared lengths (3, m) of the edges opposite to the corners.
    faces, count
        Triangles, and number of vertices.
    floor
        Of `spherical_energy.triangle_weights`.
    """

    def __init__(
        self,
        squared: Float[np.ndarray, "3 m"],
        faces: Int[np.ndarray, "m 3"],
        count: int,
        *,
        floor: float = 0.3,
        energy: str = "dirichlet",
    ) -> None:
        areas = _areas(squared)
        grown = SPHERE_AREA / areas.sum()
        squared, areas = squared * grown, areas * grown
        areas = np.maximum(areas, _FLAT * areas.mean())
        self.kind, self.faces, self.count = ENERGIES[energy], faces, count
        self.twice_areas = 2 * areas
        self.weights = np.maximum(1, floor * areas.mean() / areas)
        self.cotangents = (squared.sum(axis=0) - 2 * squared) / (4 * areas)


def _areas(squared: Float[np.ndarray, "3 m"]) -> Float[np.ndarray, " m"]:
    """Areas of triangles by Heron's formula from squared lengths."""
    sixteenfold = np.square(squared.sum(axis=0)) - 2 * np.square(squared).sum(axis=0)
    area: np.ndarray = np.sqrt(np.maximum(sixteenfold, 0)) / 4
    return area


def place_for_all(
    images: Float[np.ndarray, "k n 3"],
    faces: Int[np.ndarray, "m 3"],
    start: Float[np.ndarray, "n 3"],
    *,
    energy: str,
    floor: float,
    max_iterations: int = 100,
    tolerance: float = 1e-4,
) -> Refined:
    """Unit positions (n, 3) of the shared vertices that distort the mean metric least.

    Parameters
    ----------
    images
        The shared triangulation on k shapes of area 4π.
    start
        Unit positions without bad faces.
    energy, floor
        Of `MetricEnergy`.

    Raises
    ------
    NotEmbeddable
        The start has bad faces.
    """
    squared = mean_squared_lengths(images, faces)
    distortion = MetricEnergy(squared, faces, len(start), floor=floor, energy=energy)
    mesh = Mesh(images[0], faces, "shared surface")
    return minimise_map(
        mesh, start, distortion, max_iterations=max_iterations, tolerance=tolerance
    )
