"""Distortion of spherical maps (paper §5.1).

Both triangulations are scaled to total area 4π; spherical triangles are chordal.
"""

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int

from gensp.geometry.mesh import SPHERE_AREA


def singular_values(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, "m 2"]:
    """Singular values σ_max ≥ σ_min of J_t, surface triangle → spherical triangle.

    A triangle collapsed on the sphere has σ_min = 0.
    """
    source, image = _metric(surface, faces), _metric(sphere, faces)
    # J = image · source⁻¹ for the 2×2 matrices of edge coordinates.
    jacobian = image @ np.linalg.inv(source)
    return np.linalg.svd(jacobian, compute_uv=False)


def _metric(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 2 2"]:
    """Two edge vectors of every triangle in its own plane, at total area 4π."""
    scale = np.sqrt(SPHERE_AREA / (igl.doublearea(vertices, faces).sum() / 2))
    a, b, c = (vertices[faces[:, k]] * scale for k in range(3))
    first, second = b - a, c - a
    length = np.linalg.norm(first, axis=1)
    along = np.einsum("ij,ij->i", first, second) / np.where(length > 0, length, 1)
    height = np.linalg.norm(np.cross(first, second), axis=1) / np.where(length > 0, length, 1)
    zero = np.zeros_like(length)
    return np.stack([np.stack([length, along], 1), np.stack([zero, height], 1)], axis=1)


def isometric_distortion(values: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """σ_t = max(σ_max, 1/σ_min); 1 is an isometry, infinite for a collapsed triangle."""
    with np.errstate(divide="ignore"):
        return np.maximum(values[:, 0], 1 / values[:, 1])


def conformal_distortion(values: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """σ_t^con = max(σ_max/σ_mean, σ_mean/σ_min) with σ_mean = (σ_max + σ_min)/2."""
    mean = values.mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.maximum(values[:, 0] / mean, mean / values[:, 1]), nan=np.inf)


@dataclass(frozen=True)
class Distortion:
    """The distortion columns of the table, for one map."""

    mean: float
    max: float
    area_weighted_mean: float
    conformal_mean: float
    conformal_max: float


def distortion(
    surface: Float[np.ndarray, "n 3"],
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Distortion:
    """Summarise σ_t and σ_t^con over the triangles; the plain mean is the paper's."""
    values = singular_values(surface, sphere, faces)
    sigma, conformal = isometric_distortion(values), conformal_distortion(values)
    weights = igl.doublearea(surface, faces).reshape(-1)
    return Distortion(
        mean=float(sigma.mean()),
        max=float(sigma.max()),
        area_weighted_mean=float(np.average(sigma, weights=weights)),
        conformal_mean=float(conformal.mean()),
        conformal_max=float(conformal.max()),
    )
