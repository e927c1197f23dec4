"""How the level set of an implicit generator moves with its latent code (torch; Eq. 7–8).

Every vertex obeys one linear constraint, f_x·d_j + f_z·v = 0, so d_j = n_j α_j + T_j y_j with
n = f_x/‖f_x‖, a forced normal part α = −f_z·v/‖f_x‖ and two tangential unknowns y.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gensp.geometry.elimination import least_deforming
from gensp.geometry.isosurface import extract_surface
from gensp.geometry.reduced import Cover, residual_energy

__all__ = [
    "LevelSetVelocity",
    "RowField",
    "extract_surface",
    "implicit_deformation_ratio",
    "level_set_velocity",
    "newton_step",
    "relative_deformation",
    "tangent_bases",
]

RowField = Callable[[Tensor, Tensor], Tensor]

TINY = 1e-12  # floor of squared lengths, against 0/0 where a field or a direction is dead


@dataclass(frozen=True)
class LevelSetVelocity:
    """Displacements d^v (k, m, 3) for k latent directions, and dᵀ L^φ d of each."""

    displacements: Float[Tensor, "k m 3"]
    energies: Float[Tensor, " k"]


def level_set_velocity(
    grad_x: Float[Tensor, "m 3"],
    grad_z: Float[Tensor, "m d"],
    points: Float[Tensor, "m 3"],
    cover: Cover,
    directions: Float[Tensor, "k d"],
    *,
    scale_weight: float,
    ridge: float = 1e-6,
) -> LevelSetVelocity:
    """Least-deforming motion d^v = G^φ v of a level set when its code moves by v (Eq. 7).

    Solved in float64, returned in the dtype of `points`; differentiable in the first three
    arguments and in `directions`.

    Parameters
    ----------
    grad_x, grad_z
        ∂f/∂x and ∂f/∂z at the vertices.
    points, cover
        Vertices of the level set, with their deformation nodes and neighbourhoods.
    directions
        Latent directions v, of any length.
    scale_weight
        η of Eq. 6, once a node.
    ridge
        ε of ε‖d‖², added to the energy of which d is the minimum (never to the energy returned).
        As ε → 0 it selects the shortest d, the pseudo-inverse of the paper; on a sphere three
        rotations cost nothing and only this decides.
    """
    given = points.dtype
    grad_x, grad_z, points, directions = (
        tensor.double() for tensor in (grad_x, grad_z, points, directions)
    )
    slope = grad_x.square().sum(dim=1, keepdim=True).clamp_min(TINY).sqrt()
    normals = grad_x / slope
    speed = -(grad_z @ directions.T) / slope
    forced = normals[:, :, None] * speed[:, None, :]
    local, displacements = least_deforming(
        points, cover, tangent_bases(normals), forced, scale_weight=scale_weight, ridge=ridge
    )
    energies = residual_energy(points, cover, displacements, local, scale_weight=scale_weight)
    return LevelSetVelocity(displacements.to(given), energies.to(given))


def relative_deformation(velocity: LevelSetVelocity) -> Float[Tensor, " k"]:
    """Deformation over absolute displacement, dᵀ L^φ d / ‖d‖², of each direction (Eq. 8).

    The integral over unit v is the mean over random directions; the quotient does not see their
    length. It depends on m and l, so weights do not carry over between discretisations.
    """
    squared = velocity.displacements.square().sum(dim=(1, 2))
    return velocity.energies / squared.clamp_min(TINY)


def implicit_deformation_ratio(
    field: RowField,
    z: Float[Tensor, " d"],
    points: Float[Tensor, "m 3"],
    cover: Cover,
    directions: Float[Tensor, "k d"],
    *,
    scale_weight: float,
    ridge: float = 1e-6,
    moving_points: bool = False,
) -> Float[Tensor, " k"]:
    """The quotients of Eq. 8 for a field, differentiable in its parameters φ and in z.

    Parameters
    ----------
    field
        f(x (m, 3), z (m, d)) -> (m,), row by row.
    z, points, cover
        Latent code, vertices of its level set (held fixed), and their cover.
    moving_points
        Let the vertices depend on φ through one Newton step to the level set.
    """
    codes = z.expand(len(points), -1)
    if moving_points:
        points = newton_step(field, codes, points)
    offset_x = torch.zeros_like(points, requires_grad=True)
    offset_z = torch.zeros_like(codes, requires_grad=True)
    value = field(points + offset_x, codes + offset_z)
    grad_x, grad_z = torch.autograd.grad(value.sum(), (offset_x, offset_z), create_graph=True)
    velocity = level_set_velocity(
        grad_x, grad_z, points, cover, directions, scale_weight=scale_weight, ridge=ridge
    )
    return relative_deformation(velocity)


def newton_step(
    field: RowField, codes: Float[Tensor, "m d"], points: Float[Tensor, "m 3"]
) -> Float[Tensor, "m 3"]:
    """One step p − f f_x/‖f_x‖² to the level set, f_x held fixed (with Eq. 6).

    The derivative in φ is the normal motion of the level set, −f_φ f_x/‖f_x‖².
    """
    offset = torch.zeros_like(points, requires_grad=True)
    value = field(points + offset, codes)
    (slope,) = torch.autograd.grad(value.sum(), offset, retain_graph=True)
    return points - value[:, None] * slope / slope.square().sum(1, keepdim=True).clamp_min(TINY)


def tangent_bases(normals: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3 2"]:
    """Two orthonormal tangents of every unit normal, differentiable except across z = 0.

    The branch-free construction of Duff et al., "Building an Orthonormal Basis, Revisited", 2017.
    """
    x, y, z = normals.unbind(dim=1)
    sign = torch.ones_like(z).copysign(z.detach())
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], dim=1)
    second = torch.stack([b, sign + y * y * a, -y], dim=1)
    return torch.stack([first, second], dim=2)
