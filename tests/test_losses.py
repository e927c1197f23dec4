import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from gensp import losses
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.reduced import deformation_cover
from gensp.geometry.sphere import icosphere
from gensp.models import ImplicitField


def double(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, dtype=torch.float64, requires_grad=True)


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(0)


def test_sdf_loss_of_known_deviations() -> None:
    predicted, distance = torch.tensor([[1.0, -2.0]]), torch.tensor([[0.5, -4.0]])
    assert losses.sdf_loss(predicted, distance).item() == pytest.approx((0.25 + 4) / 2)
    assert losses.sdf_loss(predicted, distance, "l1").item() == pytest.approx(1.25)
    assert losses.sdf_loss(predicted, distance, "l1", 0.6).item() == pytest.approx((0 + 1.4) / 2)
    assert losses.sdf_loss(predicted, distance, "clamped").item() == 0
    near = torch.tensor([[0.05, -2.0]]), torch.tensor([[-0.02, 3.0]])
    assert losses.sdf_loss(*near, "clamped").item() == pytest.approx((0.07 + 0.2) / 2)


@pytest.mark.parametrize("norm", ["l1", "l2", "clamped"])
def test_sdf_loss_gradient(norm: str) -> None:
    assert gradcheck(lambda p: losses.sdf_loss(p, torch.zeros_like(p), norm), double(2, 3))


def test_encoder_penalty_of_codes_and_of_weights() -> None:
    assert losses.encoder_penalty(torch.tensor([[1.0, -3.0]])).item() == 2
    pieces = torch.tensor([1.0, -1.0, 4.0]), torch.tensor([[2.0]])
    assert losses.encoder_penalty(*pieces).item() == 2
    assert gradcheck(losses.encoder_penalty, (double(2, 3), double(4)))


def test_origin_penalty() -> None:
    assert losses.origin_penalty(torch.tensor([3.0, 4.0])).item() == 25
    assert gradcheck(losses.origin_penalty, double(5))


def test_correspondence_loss_of_a_translation() -> None:
    targets = torch.randn(2, 5, 3)
    moved = targets + torch.tensor([1.0, 2.0, 2.0])
    everywhere = torch.ones(2, 5, dtype=torch.bool)
    assert losses.correspondence_loss(moved, targets, everywhere).item() == pytest.approx(9)


def test_invalid_correspondences_have_zero_gradient_even_as_nan() -> None:
    generated, targets = double(2, 4, 3), torch.randn(2, 4, 3, dtype=torch.float64)
    valid = torch.tensor([[True, False, True, True], [False, True, True, False]])
    targets[~valid] = torch.nan
    losses.correspondence_loss(generated, targets, valid).backward()
    assert (generated.grad[~valid] == 0).all()
    assert (generated.grad[valid] != 0).all()
    clean = torch.zeros_like(targets)
    assert gradcheck(lambda g: losses.correspondence_loss(g, clean, valid), double(2, 4, 3))


def test_correspondence_loss_without_any_valid_point_is_zero() -> None:
    nowhere = torch.zeros(1, 3, dtype=torch.bool)
    assert losses.correspondence_loss(torch.ones(1, 3, 3), torch.zeros(1, 3, 3), nowhere) == 0


def cube() -> Mesh:
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(faces), "cube")


def test_surface_loss_is_zero_on_the_mesh_and_the_square_of_an_offset() -> None:
    tree = ClosestPointTree(cube())
    on = torch.tensor([[[1.0, 0.3, -0.2], [0.1, -1.0, 0.5]]])
    assert losses.surface_loss(on, [tree]).item() == pytest.approx(0, abs=1e-12)
    off = on + torch.tensor([[[0.5, 0.0, 0.0], [0.0, 0.25, 0.0]]])
    assert losses.surface_loss(off, [tree]).item() == pytest.approx((0.25 + 0.0625) / 2)


def test_surface_loss_gradient_is_exact_though_closest_points_are_held() -> None:
    trees = [ClosestPointTree(cube()), ClosestPointTree(icosphere(2))]
    points = (1.7 * torch.randn(2, 6, 3, dtype=torch.float64)).requires_grad_()
    assert gradcheck(lambda g: losses.surface_loss(g, trees), points)


def test_coverage_loss_sees_a_retracted_limb_that_the_surface_loss_does_not(
    dumbbell: Mesh,
) -> None:
    whole = torch.from_numpy(dumbbell.vertices)[None]
    inner = Mesh(dumbbell.vertices, dumbbell.faces)
    retracted = whole.clone()
    tips = retracted[..., 0].abs() > 1
    closest = ClosestPointTree(inner).query(0.5 * retracted[tips].numpy()).points
    retracted[tips] = torch.from_numpy(closest)
    assert losses.surface_loss(retracted, [ClosestPointTree(inner)]).item() < 1e-20
    assert losses.coverage_loss(whole, whole, dumbbell.faces).item() < 1e-20
    assert losses.coverage_loss(whole, retracted, dumbbell.faces).item() > 1e-2


def test_coverage_loss_gradient() -> None:
    ball = icosphere(0)
    vertices = torch.tensor(ball.vertices)[None].requires_grad_()
    samples = 1.5 * torch.randn(1, 8, 3, dtype=torch.float64)
    assert gradcheck(lambda v: losses.coverage_loss(samples, v, ball.faces), vertices)


def rotation(angle: float) -> torch.Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)


def test_generator_deformation_of_a_rotation_is_zero() -> None:
    frame = rotation(0.7)[:, :2].expand(1, 4, 3, 2)
    assert losses.generator_deformation(frame, 0.01).item() == pytest.approx(0, abs=1e-28)


@pytest.mark.parametrize("scale", [0.5, 1.3, 2.0])
def test_isometry_and_conformality_of_a_scaling(scale: float) -> None:
    jacobian = scale * rotation(0.3)[:, :2].expand(1, 4, 3, 2)
    known = 2 * 0.01 * (scale**2 - 1) ** 2
    assert losses.generator_deformation(jacobian, 0.01).item() == pytest.approx(known)
    assert losses.generator_deformation(jacobian, 0.0).item() == pytest.approx(0, abs=1e-28)


def test_isometry_and_conformality_of_a_stretch() -> None:
    metric = torch.diag(torch.tensor([4.0, 1.0]))
    # ‖A − I‖² = 9, trace part 2.5 leaves ±1.5 on the diagonal.
    assert losses.isometry_and_conformality(metric, 0.1).item() == pytest.approx(0.9 + 4.5)


def test_generator_deformation_gradient() -> None:
    assert gradcheck(lambda j: losses.generator_deformation(j, 0.01), double(2, 3, 3, 2))


class Translating(torch.nn.Module):
    """A sphere whose code is its centre: every change of code is a rigid motion."""

    def forward(self, x: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        return (x - z).norm(dim=1) - 1


def test_implicit_deformation_of_a_translating_sphere_is_zero() -> None:
    points = torch.from_numpy(icosphere(2).vertices.copy())
    value = losses.implicit_deformation(
        Translating(),
        torch.zeros(3, dtype=torch.float64),
        points,
        deformation_cover(points, 16),
        torch.randn(4, 3, dtype=torch.float64),
        scale_weight=0.1,
    )
    assert value.item() == pytest.approx(0, abs=1e-4)


def test_implicit_deformation_reaches_the_parameters_of_the_field() -> None:
    field = ImplicitField(4, width=16, depth=2, inject=[])
    points = torch.from_numpy(icosphere(2).vertices).float()
    value = losses.implicit_deformation(
        field.rowwise,
        torch.randn(4),
        points,
        deformation_cover(points, 16),
        torch.randn(2, 4),
        0.1,
    )
    value.backward()
    reached = {name for name, p in field.named_parameters() if p.grad is not None and p.grad.any()}
    assert {"trunk.hidden.0.weight", "trunk.hidden.1.weight", "trunk.last.weight"} <= reached
