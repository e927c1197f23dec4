"""The reduced deformation model against brute force and closed forms."""

import pytest
import torch
from saddle_reference import (
    appendix_matrices,
    appendix_quadratic,
    brute_force_energy,
    neighbourhoods,
)
from torch import Tensor

from gensp.geometry.mesh import Mesh
from gensp.geometry.reduced import (
    Cover,
    deformation_cover,
    farthest_points,
    local_deformations,
    reduced_energy,
    reduced_quadratic,
)

ETA = 0.3


@pytest.fixture
def points(bumpy: Mesh) -> Tensor:
    return torch.from_numpy(bumpy.vertices[:162].copy())


@pytest.fixture
def cover(points: Tensor) -> Cover:
    return deformation_cover(points, 20)


@pytest.fixture
def displacements(points: Tensor) -> Tensor:
    return torch.randn(3, *points.shape, dtype=points.dtype, generator=torch.manual_seed(0))


def test_farthest_points_on_a_line() -> None:
    line = torch.tensor([[0.0], [0.1], [0.45], [1.0]]) * torch.tensor([[1.0, 0.0, 0.0]])
    assert farthest_points(line, 3).tolist() == [3, 0, 2]


def test_cover_covers_and_overlaps(points: Tensor, cover: Cover) -> None:
    memberships = torch.bincount(cover.pairs[:, 1], minlength=len(points))
    assert len(set(cover.nodes.tolist())) == 20
    assert memberships.min() >= 3
    assert all(len(group) >= 3 for group in neighbourhoods(cover))
    assert (cover.centres != cover.pairs[:, 1]).all()
    assert len(torch.unique(cover.pairs, dim=0)) == len(cover.pairs)


def test_cover_contains_the_nearest_nodes(points: Tensor, cover: Cover) -> None:
    vertex = next(j for j in range(len(points)) if j not in cover.nodes.tolist())
    distance = (points[cover.nodes] - points[vertex]).norm(dim=1)
    joined = cover.pairs[cover.pairs[:, 1] == vertex, 0]
    assert set(distance.argsort()[:3].tolist()) <= set(joined.tolist())


@pytest.mark.parametrize("nodes", [20, 162])
def test_energy_is_the_brute_force_minimum(
    points: Tensor, displacements: Tensor, nodes: int
) -> None:
    cover = deformation_cover(points, nodes)
    energy = reduced_energy(points, cover, displacements, scale_weight=ETA)
    expected = [brute_force_energy(points, cover, d, ETA) for d in displacements]
    torch.testing.assert_close(energy, energy.new_tensor(expected), rtol=1e-12, atol=0)


def test_matrix_of_appendix_a_two_ways(
    points: Tensor, cover: Cover, displacements: Tensor
) -> None:
    matrix = reduced_quadratic(points, cover, scale_weight=ETA)
    torch.testing.assert_close(matrix, appendix_quadratic(points, cover, ETA), rtol=0, atol=1e-12)
    flat = displacements.flatten(1)
    torch.testing.assert_close(
        torch.einsum("ki,ij,kj->k", flat, matrix, flat),
        reduced_energy(points, cover, displacements, scale_weight=ETA),
    )


def test_local_deformations_are_h_inverse_b_transposed(
    points: Tensor, cover: Cover, displacements: Tensor
) -> None:
    _, coupling, hessian = appendix_matrices(points, cover, ETA)
    expected = torch.linalg.solve(hessian, coupling.T @ displacements.flatten(1).T)
    actual = local_deformations(points, cover, displacements, scale_weight=ETA)
    torch.testing.assert_close(actual, expected.T.reshape(actual.shape))


def test_null_space_is_the_six_rigid_motions(points: Tensor, cover: Cover) -> None:
    values = torch.linalg.eigvalsh(reduced_quadratic(points, cover, scale_weight=ETA))
    assert values[:6].abs().max() < 1e-12
    assert values[6] > 1e-3


def test_rigid_motion_costs_nothing_and_is_recovered(points: Tensor, cover: Cover) -> None:
    angular, shift = torch.tensor([[0.3, -1.0, 0.5], [2.0, 0.1, 0.0]]).to(points)
    motion = torch.linalg.cross(angular.expand_as(points), points) + shift
    local = local_deformations(points, cover, motion[None], scale_weight=ETA)[0]
    assert reduced_energy(points, cover, motion[None], scale_weight=ETA).abs() < 1e-20
    torch.testing.assert_close(local[:, 1:], angular.expand(20, 3))
    torch.testing.assert_close(local[:, 0], torch.zeros(20).to(points))


def test_scaling_costs_exactly_the_eta_term(points: Tensor, cover: Cover) -> None:
    scaling = 0.7 * points
    free = reduced_energy(points, cover, scaling[None], scale_weight=0.0)
    paid = reduced_energy(points, cover, scaling[None], scale_weight=ETA)
    # min over s of (s − 0.7)² w + η s², with w = Σ‖q‖² over the pairs of a node.
    squared = (points[cover.centres] - points[cover.pairs[:, 1]]).square().sum(dim=1)
    weight = torch.zeros(20).to(points).index_add(0, cover.pairs[:, 0], squared)
    assert free.abs() < 1e-20
    torch.testing.assert_close(paid[0], (0.7**2 * ETA * weight / (weight + ETA)).sum())


def test_energy_is_invariant_to_rotating_everything(
    points: Tensor, cover: Cover, displacements: Tensor
) -> None:
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.manual_seed(1)).to(points))
    energy = reduced_energy(points, cover, displacements, scale_weight=ETA)
    turned = reduced_energy(points @ turn.T, cover, displacements @ turn.T, scale_weight=ETA)
    torch.testing.assert_close(turned, energy)


def test_dtype_of_the_caller(points: Tensor, cover: Cover, displacements: Tensor) -> None:
    energy = reduced_energy(points.float(), cover, displacements.float(), scale_weight=ETA)
    assert energy.dtype == torch.float32
    exact = reduced_energy(points, cover, displacements, scale_weight=ETA)
    torch.testing.assert_close(energy.double(), exact, rtol=1e-4, atol=0)
