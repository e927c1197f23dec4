"""Moving level sets: known motions, agreement with the saddle system, derivatives."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from saddle_reference import appendix_quadratic, null_space_velocity, saddle_velocity
from torch import Tensor

from gensp.geometry.levelset import (
    LevelSetVelocity,
    extract_surface,
    implicit_deformation_ratio,
    level_set_velocity,
    newton_step,
    relative_deformation,
    tangent_bases,
)
from gensp.geometry.mesh import Mesh
from gensp.geometry.reduced import Cover, deformation_cover, reduced_energy
from gensp.geometry.sphere import icosphere

ETA = 0.1


@dataclass(frozen=True)
class Problem:
    """A level set without symmetry, moved by a random field."""

    grad_x: Tensor
    grad_z: Tensor
    points: Tensor
    cover: Cover
    directions: Tensor

    def solve(self, ridge: float = 0.0) -> LevelSetVelocity:
        return level_set_velocity(
            self.grad_x,
            self.grad_z,
            self.points,
            self.cover,
            self.directions,
            scale_weight=ETA,
            ridge=ridge,
        )


def problem_on(points: Tensor, normals: Tensor, nodes: int) -> Problem:
    generator = torch.manual_seed(0)
    noise = torch.rand(len(points), 1, generator=generator).to(points)
    grad_z = torch.randn(len(points), 5, generator=generator).to(points)
    directions = torch.randn(3, 5, generator=generator).to(points)
    cover = deformation_cover(points, nodes)
    return Problem(normals * (0.5 + noise), grad_z, points, cover, directions)


@pytest.fixture
def problem() -> Problem:
    ball = icosphere(2)
    x, y, _ = ball.vertices.T
    stretched = (1 + 0.25 * np.sin(3 * x + 1) * np.cos(2 * y))[:, None] * ball.vertices
    mesh = Mesh(stretched * np.array([1.4, 1.0, 0.7]), ball.faces)
    normals = torch.from_numpy(mesh.vertex_normals.copy())
    return problem_on(torch.from_numpy(mesh.vertices), normals, nodes=20)


@pytest.fixture
def sphere() -> Problem:
    points = torch.from_numpy(icosphere(2).vertices.copy())
    return problem_on(points, points, nodes=20)


def test_tangent_bases_are_orthonormal() -> None:
    normals = torch.nn.functional.normalize(
        torch.randn(50, 3, dtype=torch.float64, generator=torch.manual_seed(0)), dim=1
    )
    normals[0] = torch.tensor([0.0, 0.0, -1.0])
    frames = torch.cat([tangent_bases(normals), normals[:, :, None]], dim=2)
    torch.testing.assert_close(frames.mT @ frames, torch.eye(3).expand(50, 3, 3).to(frames))


def test_elimination_equals_saddle_and_null_space(problem: Problem) -> None:
    quadratic = appendix_quadratic(problem.points, problem.cover, ETA)
    forcing = problem.grad_z @ problem.directions.T
    velocity = problem.solve()
    for reference in (saddle_velocity, null_space_velocity):
        expected = reference(quadratic, problem.grad_x, forcing)
        torch.testing.assert_close(velocity.displacements, expected, rtol=0, atol=1e-10)


def test_ridge_is_the_saddle_system_with_a_ridge(problem: Problem) -> None:
    quadratic = appendix_quadratic(problem.points, problem.cover, ETA)
    quadratic += 0.05 * torch.eye(len(quadratic)).to(quadratic)
    expected = saddle_velocity(quadratic, problem.grad_x, problem.grad_z @ problem.directions.T)
    actual = problem.solve(ridge=0.05).displacements
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-10)


def test_constraint_holds_to_rounding(problem: Problem) -> None:
    moved = torch.einsum("mr,kmr->mk", problem.grad_x, problem.solve().displacements)
    residual = moved + problem.grad_z @ problem.directions.T
    assert residual.abs().max() < 1e-12


def test_energy_is_the_quadratic_form(problem: Problem) -> None:
    velocity = problem.solve(ridge=1e-3)
    expected = reduced_energy(
        problem.points, problem.cover, velocity.displacements, scale_weight=ETA
    )
    torch.testing.assert_close(velocity.energies, expected)


def test_every_vertex_a_node(problem: Problem) -> None:
    cover = deformation_cover(problem.points, len(problem.points))
    velocity = level_set_velocity(
        problem.grad_x,
        problem.grad_z,
        problem.points,
        cover,
        problem.directions,
        scale_weight=ETA,
        ridge=0.0,
    )
    quadratic = appendix_quadratic(problem.points, cover, ETA)
    forcing = problem.grad_z @ problem.directions.T
    expected = saddle_velocity(quadratic, problem.grad_x, forcing)
    torch.testing.assert_close(velocity.displacements, expected, rtol=0, atol=1e-10)


def test_translating_sphere_moves_by_the_constant(sphere: Problem) -> None:
    """f(x, z) = |x − z| − 1 at z = 0: d^v = v, the shortest of the free motions."""
    directions = torch.eye(3).to(sphere.points)
    velocity = level_set_velocity(
        sphere.points,
        -sphere.points,
        sphere.points,
        sphere.cover,
        directions,
        scale_weight=ETA,
        ridge=1e-8,
    )
    constant = directions[:, None, :].expand_as(velocity.displacements)
    torch.testing.assert_close(velocity.displacements, constant, rtol=0, atol=1e-6)
    assert relative_deformation(velocity).max() < 1e-12


def test_growing_sphere_moves_along_the_normal(sphere: Problem) -> None:
    """f(x, z) = |x| − 1 − z: as η → 0 the scaling is free and d is the normal."""
    grad_z = -torch.ones(len(sphere.points), 1).to(sphere.points)
    deviation = []
    for eta in (1.0, 1e-3, 1e-9):
        velocity = level_set_velocity(
            sphere.points,
            grad_z,
            sphere.points,
            sphere.cover,
            torch.ones(1, 1).to(grad_z),
            scale_weight=eta,
        )
        deviation.append(float((velocity.displacements[0] - sphere.points).abs().max()))
    assert deviation[0] > deviation[1] > deviation[2]
    assert deviation[2] < 1e-6


def test_ridge_selects_the_pseudo_inverse_on_the_sphere(sphere: Problem) -> None:
    """Three rotations lie in the kernel; the paper's † and a small ridge agree on the rest."""
    quadratic = appendix_quadratic(sphere.points, sphere.cover, ETA)
    bases = torch.block_diag(*tangent_bases(sphere.points))
    values = torch.linalg.eigvalsh(bases.T @ quadratic @ bases)
    assert values[2] < 1e-12 < 1e-3 < values[3]
    expected = saddle_velocity(
        quadratic,
        sphere.grad_x,
        sphere.grad_z @ sphere.directions.T,
        pseudo_inverse=True,
    )
    actual = sphere.solve(ridge=1e-8).displacements
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-5)


def test_quotient_does_not_see_the_length_of_v(problem: Problem) -> None:
    longer = Problem(
        problem.grad_x, problem.grad_z, problem.points, problem.cover, -7 * problem.directions
    )
    torch.testing.assert_close(
        relative_deformation(longer.solve()), relative_deformation(problem.solve())
    )


def test_dead_direction_has_a_finite_quotient(problem: Problem) -> None:
    still = Problem(
        problem.grad_x, 0 * problem.grad_z, problem.points, problem.cover, problem.directions
    )
    assert (relative_deformation(still.solve()) == 0).all()


def test_gradients_through_the_elimination(problem: Problem) -> None:
    inputs = (problem.grad_x, problem.grad_z, problem.points)
    for tensor in inputs:
        tensor.requires_grad_(True)
    relative_deformation(problem.solve(ridge=1e-4)).sum().backward()
    generator, step = torch.manual_seed(3), 1e-5
    for index, tensor in enumerate(inputs):
        change = torch.randn(tensor.shape, generator=generator).to(tensor)
        values = []
        for sign in (1, -1):
            moved = [t.detach().clone() for t in inputs]
            moved[index] += sign * step * change
            shifted = Problem(*moved, problem.cover, problem.directions)
            values.append(float(relative_deformation(shifted.solve(ridge=1e-4)).sum()))
        assert tensor.grad is not None
        expected = (values[0] - values[1]) / (2 * step)
        assert float((tensor.grad * change).sum()) == pytest.approx(expected, rel=1e-5)


class Bumps(torch.nn.Module):
    """A smooth family f(x, z) with parameters, close to a distance."""

    def __init__(self) -> None:
        super().__init__()
        generator = torch.manual_seed(1)
        self.phi = torch.nn.Parameter(0.3 * torch.randn(3, 4, generator=generator).double())

    def forward(self, x: Tensor, z: Tensor) -> Tensor:
        return x.norm(dim=1) - 1 - 0.2 * torch.sin(x @ self.phi + z).sum(dim=1)


def surface_of(field: Bumps, z: Tensor) -> Tensor:
    mesh = extract_surface(
        lambda x: field(x, z.expand(len(x), -1)),
        resolution=24,
        vertices=150,
        bounds=2.5,
        dtype=torch.float64,
    )
    points = torch.from_numpy(mesh.vertices)
    for _ in range(4):
        points = newton_step(field, z.expand(len(points), -1), points).detach()
    return points


def test_newton_steps_reach_the_level_set() -> None:
    field, z = Bumps(), torch.tensor([0.1, -0.2, 0.3, 0.0]).double()
    points = surface_of(field, z)
    assert field(points, z.expand(len(points), -1)).abs().max() < 1e-12


@pytest.mark.parametrize("moving_points", [False, True])
def test_gradients_reach_the_field(moving_points: bool) -> None:
    field, z = Bumps(), torch.tensor([0.1, -0.2, 0.3, 0.0]).double()
    points, directions = surface_of(field, z), torch.eye(4).double()
    cover = deformation_cover(points, 20)

    def mean_ratio() -> Tensor:
        return implicit_deformation_ratio(
            field,
            z,
            points,
            cover,
            directions,
            scale_weight=ETA,
            moving_points=moving_points,
        ).mean()

    mean_ratio().backward()
    assert field.phi.grad is not None
    change = torch.randn(3, 4, generator=torch.manual_seed(2)).double()
    slope = float((field.phi.grad * change).sum())
    field.phi.data += 1e-5 * change
    ahead = mean_ratio().item()
    field.phi.data -= 2e-5 * change
    behind = mean_ratio().item()
    assert slope == pytest.approx((ahead - behind) / 2e-5, rel=1e-5)


def test_translating_field_has_no_relative_deformation() -> None:
    """Eq. 5 of a rigidly translating family is zero."""
    points = torch.from_numpy(icosphere(2).vertices * np.array([1.3, 1.0, 0.8]))
    axes = torch.tensor([1.3, 1.0, 0.8]).double()
    ratio = implicit_deformation_ratio(
        lambda x, z: ((x - z) / axes).square().sum(dim=1) - 1,
        torch.zeros(3).double(),
        points,
        deformation_cover(points, 20),
        torch.eye(3).double(),
        scale_weight=ETA,
    )
    assert ratio.max() < 1e-10
