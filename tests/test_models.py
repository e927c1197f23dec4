from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from gensp.errors import Unsupported
from gensp.geometry import sphere
from gensp.models import (
    AnchoredGenerator,
    DirectGenerator,
    FlowGenerator,
    Generator,
    Grouping,
    ImplicitField,
    LatentMLP,
    PointNet2Encoder,
    jacobian,
)
from gensp.models.encoder import farthest_points, nearest_groups
from gensp.models.generator import tangent_frame

LATENT = 5
LAYERS = {"width": 16, "depth": 4, "inject": [3]}


def trunk(inputs: int = 3, outputs: int = 3, **settings: int) -> LatentMLP:
    return LatentMLP(LATENT, inputs, outputs, **{**LAYERS, **settings})


def generators() -> dict[str, Generator]:
    torch.manual_seed(1)
    networks = {
        "direct": DirectGenerator(LATENT, **LAYERS),
        "difference": AnchoredGenerator(LATENT, form="difference", **LAYERS),
        "blend": AnchoredGenerator(LATENT, form="blend", rank=3, **LAYERS),
        "linear": AnchoredGenerator(LATENT, form="linear", rank=3, **LAYERS),
        "flow": FlowGenerator(LATENT, rank=3, steps=3, **LAYERS),
    }
    for network in networks.values():
        torch.nn.init.normal_(network.trunk.last.weight, std=0.2)
        torch.nn.init.normal_(network.trunk.last.bias, std=0.2)
    return networks


def sphere_points(batch: int, count: int, seed: int = 0) -> Tensor:
    points = sphere.sample_sphere(batch * count, np.random.default_rng(seed))
    return torch.from_numpy(points.reshape(batch, count, 3))


@pytest.fixture
def encoder() -> PointNet2Encoder:
    torch.manual_seed(0)
    return PointNet2Encoder(LATENT, width=8, groups=((32, 8), (8, 4)))


def test_encoder_gives_one_code_per_cloud(encoder: PointNet2Encoder) -> None:
    codes = encoder(torch.randn(3, 100, 3))
    assert codes.shape == (3, LATENT)
    assert codes.dtype == torch.float32


def test_encoder_does_not_depend_on_the_order_of_points(encoder: PointNet2Encoder) -> None:
    cloud = torch.randn(2, 120, 3, generator=torch.Generator().manual_seed(3))
    shuffled = cloud[:, torch.randperm(120, generator=torch.Generator().manual_seed(4))]
    torch.testing.assert_close(encoder(shuffled), encoder(cloud), rtol=1e-4, atol=1e-5)
    assert not torch.allclose(encoder(cloud + 0.1), encoder(cloud))


def test_encoder_with_kept_groupings_equals_encoder_without(encoder: PointNet2Encoder) -> None:
    clouds = torch.randn(4, 80, 3)
    kept = Grouping.cat([encoder.group(cloud[None]) for cloud in clouds])
    torch.testing.assert_close(encoder(clouds, kept.to("cpu")), encoder(clouds))


def test_encoder_code_of_the_origin_cloud_becomes_zero(encoder: PointNet2Encoder) -> None:
    ball, other = sphere_points(1, 90).float(), torch.randn(1, 90, 3)
    difference = encoder(other) - encoder(ball)
    encoder.set_origin(ball)
    torch.testing.assert_close(encoder(ball), torch.zeros(1, LATENT), rtol=0, atol=1e-6)
    torch.testing.assert_close(encoder(other), difference)


def test_farthest_points_of_two_clusters_take_both() -> None:
    cloud = torch.cat([torch.zeros(50, 3), torch.ones(2, 3) * 9]) + 1e-3 * torch.randn(52, 3)
    chosen = farthest_points(cloud[None], 2)[0]
    assert (chosen >= 50).sum() == 1


def test_nearest_groups_agree_with_brute_force_and_respect_the_radius() -> None:
    points = torch.randn(2, 60, 3)
    centres = points[:, :5]
    squared = torch.cdist(centres, points).square()
    assert torch.equal(nearest_groups(points, centres, 7), squared.topk(7, largest=False)[1])
    near = nearest_groups(points, centres, 60, radius=0.8)
    assert (squared.gather(2, near) <= 0.8**2 + 1e-6).all()
    assert near.unique().numel() > 5


def test_latent_mlp_equals_the_network_on_joined_inputs() -> None:
    network = trunk(octaves=2).double()
    z, x = torch.randn(2, LATENT).double(), torch.randn(2, 7, 3).double()
    joined = z[:, None].expand(-1, 7, -1)
    frequencies = torch.tensor([np.pi / 2, np.pi]).double()
    angles = (x[..., None] * frequencies).reshape(2, 7, 6)
    encoded = torch.cat([x, angles.sin(), angles.cos()], dim=2)
    h = encoded[..., :0]
    for k, layer in enumerate(network.hidden, start=1):
        inputs = torch.cat([joined, encoded, h], dim=2) if k in (1, 3) else h
        h = torch.nn.functional.silu(inputs @ layer.weight.T + layer.bias)
    torch.testing.assert_close(network(z, x), h @ network.last.weight.T + network.last.bias)


def test_latent_mlp_keeps_the_code_through_ten_layers() -> None:
    torch.manual_seed(0)
    network = LatentMLP(LATENT, 3, 1, width=64, depth=10, inject=())
    x = torch.randn(1, 50, 3)
    change = network(torch.randn(1, LATENT), x) - network(torch.randn(1, LATENT), x)
    assert change.abs().mean() > 1e-2


def test_field_gradients_equal_central_differences() -> None:
    field = ImplicitField(LATENT, octaves=1, **LAYERS).double()
    z, x = torch.randn(2, LATENT).double(), torch.randn(2, 6, 3).double()
    gradients = field.gradients(z, x)
    torch.testing.assert_close(gradients.value, field(z, x))
    step = 1e-5
    for axis in range(3):
        e = step * torch.eye(3).double()[axis]
        slope = (field(z, x + e) - field(z, x - e)) / (2 * step)
        torch.testing.assert_close(gradients.x[..., axis], slope, rtol=1e-6, atol=1e-8)
    for axis in range(LATENT):
        e = step * torch.eye(LATENT).double()[axis]
        slope = (field(z + e, x) - field(z - e, x)) / (2 * step)
        torch.testing.assert_close(gradients.z[..., axis], slope, rtol=1e-6, atol=1e-8)


def test_field_gradients_reach_the_parameters_and_the_code() -> None:
    field = ImplicitField(LATENT, **LAYERS)
    z = torch.randn(1, LATENT, requires_grad=True)
    gradients = field.gradients(z, torch.randn(1, 6, 3))
    (gradients.x.square().sum() + gradients.z.square().sum()).backward()
    reached = {name for name, p in field.named_parameters() if p.grad is not None and p.grad.any()}
    # The last bias shifts the value and leaves its gradients alone.
    assert reached == {name for name, _ in field.named_parameters()} - {"trunk.last.bias"}
    assert z.grad.abs().sum() > 0


def test_field_is_smooth_at_the_centre() -> None:
    field = ImplicitField(LATENT, **LAYERS)
    gradients = field.gradients(torch.zeros(1, LATENT), torch.zeros(1, 1, 3))
    gradients.x.square().sum().backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in field.parameters())


def test_sphere_residual_field_without_residual_is_the_sphere() -> None:
    field = ImplicitField(LATENT, **LAYERS)
    torch.nn.init.zeros_(field.trunk.last.weight)
    torch.nn.init.zeros_(field.trunk.last.bias)
    x = torch.randn(2, 9, 3)
    torch.testing.assert_close(field(torch.randn(2, LATENT), x), x.norm(dim=2) - 1)


@pytest.mark.parametrize("name", list(generators()))
def test_generator_gives_points_of_the_callers_dtype(name: str) -> None:
    generator = generators()[name].double()
    points = generator(torch.randn(2, LATENT).double(), sphere_points(2, 11))
    assert points.shape == (2, 11, 3)
    assert points.dtype == torch.float64


@pytest.mark.parametrize("name", ["blend", "difference", "linear", "flow"])
def test_anchored_generators_are_the_sphere_at_zero(name: str) -> None:
    generator, p = generators()[name], sphere_points(2, 20).float()
    assert torch.equal(generator(torch.zeros(2, LATENT), p), p)
    assert not torch.allclose(generator(torch.ones(2, LATENT), p), p, atol=1e-3)


@pytest.mark.parametrize("name", list(generators()))
def test_jacobian_equals_central_differences(name: str) -> None:
    generator = generators()[name].double()
    z, p = torch.randn(2, LATENT).double(), sphere_points(2, 9)
    columns, frame, step = jacobian(generator, z, p), tangent_frame(p), 1e-5
    for k in range(2):
        e = step * frame[..., k]
        slope = (generator(z, p + e) - generator(z, p - e)) / (2 * step)
        torch.testing.assert_close(columns[..., k], slope, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", list(generators()))
def test_jacobian_reaches_the_parameters(name: str) -> None:
    generator = generators()[name]
    jacobian(
        generator, torch.randn(2, LATENT), sphere_points(2, 4).float()
    ).square().sum().backward()
    trained = [p for p in generator.parameters() if p.requires_grad]
    grown = [p.grad is not None and p.grad.abs().sum() > 0 for p in trained]
    # The last bias shifts points and leaves the Jacobian of the plain forms alone; `difference`
    # does without A.
    assert sum(grown) >= len(grown) - 1


def test_tangent_frame_equals_the_one_of_the_geometry() -> None:
    p = sphere_points(3, 40)
    frame = sphere.tangent_frame(p.reshape(-1, 3).numpy())
    np.testing.assert_allclose(tangent_frame(p).reshape(-1, 3, 2).numpy(), frame, atol=1e-14)


def test_latent_scale_gives_the_wanted_spread() -> None:
    codes = 30 + 0.1 * torch.randn(50, LATENT)
    generator = DirectGenerator(LATENT, **LAYERS)
    generator.fit_latents(codes, spread=2.0)
    scaled = generator.scaled(codes)
    assert (scaled - scaled.mean(0)).square().sum(1).mean().sqrt() == pytest.approx(2, rel=1e-4)
    generator.fit_latents(codes[:1])
    assert generator.latent_scale.isfinite()


@pytest.mark.parametrize("name", ["blend", "linear", "flow"])
def test_mixing_begins_with_the_mean_and_the_principal_axes(name: str) -> None:
    codes = torch.randn(20, LATENT) * torch.tensor([3.0, 1, 0.5, 0.1, 0.1]) + 40
    generator = generators()[name]
    generator.fit_latents(codes, spread=2.0)
    mixed = generator.mixing(generator.scaled(codes))
    assert mixed[:, 0].mean().item() == pytest.approx(1, rel=1e-4)
    centred = mixed - mixed.mean(dim=0)
    covariance = centred.T @ centred / 20
    assert covariance[1, 1] > covariance[2, 2] > 0
    assert covariance[1, 2].abs() < 1e-3
    # The axes are orthonormal and orthogonal to the mean.
    frame = torch.nn.functional.normalize(generator.mixing.weight, dim=1)
    torch.testing.assert_close(frame @ frame.T, torch.eye(3), rtol=0, atol=1e-4)


def test_flow_does_not_fold_the_sphere() -> None:
    generator = generators()["flow"].double()
    z, p = torch.randn(1, LATENT).double(), sphere_points(1, 200)
    columns = jacobian(generator, z, p)[0]
    normals = torch.linalg.cross(columns[..., 0], columns[..., 1])
    assert normals.norm(dim=1).min() > 1e-3


def test_untrained_residual_generators_are_the_sphere_for_every_code() -> None:
    z, p = 100 * torch.randn(2, LATENT), sphere_points(2, 5).float()
    assert torch.equal(AnchoredGenerator(LATENT, rank=3, **LAYERS)(z, p), p)
    assert torch.equal(FlowGenerator(LATENT, rank=3, **LAYERS)(z, p), p)


def test_unknown_form_is_refused() -> None:
    with pytest.raises(Unsupported, match="'linear' or 'difference' is required"):
        AnchoredGenerator(LATENT, form="additive", **LAYERS)


def test_same_seed_same_network(tmp_path: Path) -> None:
    first, second = generators()["linear"], generators()["linear"]
    assert all(map(torch.equal, first.parameters(), second.parameters()))
