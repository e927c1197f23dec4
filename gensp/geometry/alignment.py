"""Bringing spherical maps into one frame: Möbius centring and the best rotation."""

import numpy as np
from jaxtyping import Float, Int

from gensp.errors import NotEmbeddable
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import lumped_mass
from gensp.geometry.sphere import unit

_LONGEST_STEP = 2.0


def centre_of_area(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    areas: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " 3"]:
    """Mean direction Σ_t a_t ĉ_t of the spherical triangles, by the surface's area fractions a_t.

    Zero for a Möbius-centred map.
    """
    return areas / areas.sum() @ unit(sphere[faces].mean(axis=1))


def moebius_center(
    sphere: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    areas: Float[np.ndarray, " m"],
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
) -> Float[np.ndarray, "n 3"]:
    """Compose a map with the inversion of the ball that puts its centre of area at the origin.

    The centre is Σ_t a_t ĉ_t with the surface's area fractions a_t and the directions ĉ_t of the
    spherical triangles. Newton steps s = −J⁻¹ μ, J = 2 Σ a_t (I − ĉ_t ĉ_tᵀ), are taken through
    the Poincaré ball (Baden, Crane & Kazhdan 2018, Möbius registration). Unique up to rotation.

    Raises
    ------
    NotEmbeddable
        Half of the area or more sits in one direction: no inversion centres such a map.
    """
    u, weights = unit(sphere), areas / areas.sum()
    size = np.inf
    for _ in range(max_iterations):
        directions = unit(u[faces].mean(axis=1))
        centre = weights @ directions
        size = float(np.linalg.norm(centre))
        if size <= tolerance:
            return u
        spread = np.eye(3) - (weights[:, None] * directions).T @ directions
        try:
            step = -np.linalg.solve(2 * spread, centre)
        except np.linalg.LinAlgError:
            break  # all of the surface sits in one direction, or in it and its opposite
        u = _shorter_until_better(u, faces, weights, step, size)
    raise NotEmbeddable(
        f"Möbius centring left the centre of area at {size:.2g}; {tolerance:g} is required; the "
        "map crowds half of the surface into one point: refine it first, or use another method"
    )


def _shorter_until_better(
    u: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    weights: Float[np.ndarray, " m"],
    step: Float[np.ndarray, " 3"],
    size: float,
) -> Float[np.ndarray, "n 3"]:
    length = min(float(np.linalg.norm(step)), _LONGEST_STEP)
    axis = unit(step)
    for _ in range(30):
        moved = ball_inversion(u, np.tanh(length) * axis)
        if np.linalg.norm(weights @ unit(moved[faces].mean(axis=1))) < size:
            return moved
        length /= 2
    return moved


def ball_inversion(
    points: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "n 3"]:
    """Conformal automorphism of the unit ball, x ↦ (1 − ‖c‖²)(x + c)/‖x + c‖² + c.

    Orientation-preserving on the sphere, with the inverse at −c.
    """
    shifted = points + centre
    squares = np.einsum("ni,ni->n", shifted, shifted)[:, None]
    return unit((1 - centre @ centre) * shifted / squares + centre)


def best_rotation(
    a: Float[np.ndarray, "k 3"],
    b: Float[np.ndarray, "k 3"],
    weights: Float[np.ndarray, " k"] | None = None,
    *,
    allow_reflection: bool = False,
) -> Float[np.ndarray, "3 3"]:
    """Rotation R about the origin that minimises Σ w ‖R a − b‖² (Kabsch 1976), so b ≈ a Rᵀ."""
    weighted = a if weights is None else a * weights[:, None]
    left, _, right = np.linalg.svd(b.T @ weighted)
    if not allow_reflection and np.linalg.det(left @ right) < 0:
        left[:, -1] *= -1
    return left @ right


def normal_rotation(sphere: Float[np.ndarray, "n 3"], mesh: Mesh) -> Float[np.ndarray, "3 3"]:
    """Rotation that best turns a map's points to the surface's normals, weighed by area.

    Shapes in one frame get maps in about one frame, without knowing of each other (as the program
    of Praun & Hoppe does at its end).
    """
    areas = lumped_mass(mesh.vertices, mesh.faces)
    return best_rotation(sphere, mesh.vertex_normals, areas)
