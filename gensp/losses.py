"""The losses of the paper, in its order; each docstring opens with the equation.

Sums over shapes and samples are means here, so that weights do not depend on batch sizes.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.levelset import implicit_deformation_ratio
from gensp.geometry.mesh import Mesh
from gensp.geometry.reduced import Cover

NORMS = ("l2", "l1", "clamped")
CLAMP = 0.1  # lengths of the unit sphere; DeepSDF's


def sdf_loss(
    predicted: Float[Tensor, "b n"],
    distance: Float[Tensor, "b n"],
    norm: str = "l2",
    tolerance: float = 0.0,
) -> Float[Tensor, ""]:
    """Eq. 3: deviation of the implicit field from signed distances.

    Parameters
    ----------
    norm
        `l2`, the paper's square; `l1`, which fits thin limbs sooner; `clamped`: l1 of distances
        that end at `CLAMP` (Park et al. 2019, Eq. 4).
    tolerance
        Deviations up to this length are none (Duan et al. 2020, Eq. 4).
    """
    if norm == "clamped":
        predicted, distance = predicted.clamp(-CLAMP, CLAMP), distance.clamp(-CLAMP, CLAMP)
    deviation = ((predicted - distance).abs() - tolerance).clamp(min=0)
    return deviation.square().mean() if norm == "l2" else deviation.mean()


def encoder_penalty(*values: Float[Tensor, "..."]) -> Float[Tensor, ""]:
    """Eq. 4: L¹ penalty, as the mean absolute value of all entries.

    Of the latent codes by default; of the encoder's weights where γ is read literally.
    """
    total = torch.stack([value.abs().sum() for value in values]).sum()
    return total / sum(value.numel() for value in values)


def origin_penalty(code: Float[Tensor, " d"]) -> Float[Tensor, ""]:
    """Paper §4.2, after Eq. 9: squared norm of the sphere's code."""
    return code.square().sum()


def implicit_deformation(
    field: Callable[[Tensor, Tensor], Tensor],
    z: Float[Tensor, " d"],
    points: Float[Tensor, "m 3"],
    cover: Cover,
    directions: Float[Tensor, "k d"],
    scale_weight: float,
) -> Float[Tensor, ""]:
    """Eqs. 5 to 8: deformation of the level set of f(·, z) relative to its displacement.

    Parameters
    ----------
    field
        Maps points (m, 3) and codes (m, d), row by row, to values (m,).
    points, cover
        Vertices of the level set at z, and its reduced deformation model.
    directions
        Changes v of the code over which the quotient of Eq. 8 is averaged.
    scale_weight
        η of Eq. 6.
    """
    ratios: Tensor = implicit_deformation_ratio(
        field, z, points, cover, directions, scale_weight=scale_weight
    )
    return ratios.mean()


def correspondence_loss(
    generated: Float[Tensor, "b n 3"],
    targets: Float[Tensor, "b n 3"],
    valid: Bool[Tensor, "b n"],
) -> Float[Tensor, ""]:
    """Eq. 10: mean squared distance to the corresponding points, where they are valid.

    Faulty correspondences are left out (paper appendix B.4); they may even be NaN.
    """
    deviation = torch.where(valid[..., None], generated - targets, 0.0)
    return deviation.square().sum() / valid.sum().clamp(min=1)


def surface_loss(
    generated: Float[Tensor, "b n 3"], surfaces: Sequence[ClosestPointTree]
) -> Float[Tensor, ""]:
    """Eq. 11: mean squared distance of generated points to the surface of their shape.

    The closest points are found outside the graph; the gradient of the squared distance is exact
    all the same, because moving them along the surface changes it to second order only.
    """
    queries = _double(generated)
    closest = np.stack([tree.query(q).points for tree, q in zip(surfaces, queries, strict=True)])
    return (generated - torch.from_numpy(closest).to(generated)).square().sum(dim=2).mean()


def coverage_loss(
    samples: Float[Tensor, "b k 3"],
    generated: Float[Tensor, "b n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[Tensor, ""]:
    """Beside Eq. 11: mean squared distance of points of the shape to the generated surface.

    Eq. 11 alone lets limbs retract, for nothing pulls the surface out to their tips. `faces`
    triangulates the generated points. Without samples it is zero.
    """
    if samples.shape[1] == 0:
        return generated.new_zeros(())
    terms = []
    for points, vertices, positions in zip(samples, generated, _double(generated), strict=True):
        at = ClosestPointTree(Mesh(positions, faces)).query(_double(points)).at
        corners = vertices[torch.from_numpy(faces[at.faces]).to(vertices.device)]
        weights = torch.from_numpy(at.barycentric).to(vertices)
        terms.append((points - (weights[..., None] * corners).sum(dim=1)).square().sum(dim=1))
    return torch.stack(terms).mean()


def generator_deformation(
    jacobian: Float[Tensor, "b n 3 2"], isometry_weight: float
) -> Float[Tensor, ""]:
    """Eq. 12: mean of r(JᵀJ) over sphere points and codes; `isometry_weight` is β."""
    return isometry_and_conformality(jacobian.mT @ jacobian, isometry_weight).mean()


def isometry_and_conformality(
    metric: Float[Tensor, "*batch 2 2"], isometry_weight: float
) -> Float[Tensor, "*batch"]:
    """r(A) of Eq. 12: β‖A − I‖² + ‖A − ½⟨A, I⟩ I‖².

    Zero for an isometry; the second part alone is zero for a conformal map.
    """
    identity = torch.eye(2, dtype=metric.dtype, device=metric.device)
    half_trace = metric.diagonal(dim1=-2, dim2=-1).mean(dim=-1)[..., None, None]
    isometry = (metric - identity).square().sum(dim=(-2, -1))
    conformality = (metric - half_trace * identity).square().sum(dim=(-2, -1))
    return isometry_weight * isometry + conformality


def _double(points: Tensor) -> np.ndarray:
    return points.detach().to("cpu", torch.float64).numpy()
