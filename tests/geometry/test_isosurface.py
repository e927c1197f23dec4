"""Surfaces of implicit fields: known shapes, the coarse-to-fine grid, what cannot be used."""

import numpy as np
import pytest
import torch
from torch import Tensor

from gensp.errors import EmptyLevelSet, NotGenusZero
from gensp.geometry.levelset import extract_surface
from gensp.geometry.mesh import require_genus_zero


def test_extracted_unit_sphere() -> None:
    mesh = extract_surface(lambda x: x.norm(dim=1) - 1, resolution=48, vertices=1000, bounds=1.3)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    require_genus_zero(mesh)
    assert len(mesh.vertices) == 1000
    assert mesh.area == pytest.approx(4 * np.pi, rel=0.01)
    assert np.abs(radius - 1).max() < 4e-3


def test_fine_grid_only_near_the_surface_gives_the_same_surface() -> None:
    evaluated = []

    def field(x: Tensor) -> Tensor:
        evaluated.append(len(x))
        thin = (x[:, 1:].norm(dim=1) - 0.06).maximum(x[:, 0].abs() - 1.2)
        return (x.norm(dim=1) - 0.5).minimum(thin)

    box = np.array([[-1.4, -0.7, -0.7], [1.4, 0.7, 0.7]])
    mesh = extract_surface(field, resolution=64, vertices=None, bounds=box)
    assert sum(evaluated) < 0.4 * 65 * 33 * 33
    axes = [np.linspace(*side, n) for side, n in zip(box.T, (65, 33, 33), strict=True)]
    whole = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = field(torch.from_numpy(whole.reshape(-1, 3))).numpy() < 0
    volume = inside.sum() * (2.8 / 64) ** 3
    corners = mesh.vertices[mesh.faces]
    assert mesh.euler == 2
    assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(2.4, abs=0.05)
    assert np.linalg.det(corners).sum() / 6 == pytest.approx(volume, rel=0.05)


def test_grid_points_on_the_surface_give_sound_triangles() -> None:
    mesh = extract_surface(
        lambda x: x.abs().amax(dim=1) - 0.5, resolution=16, vertices=None, bounds=1.0
    )
    require_genus_zero(mesh)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(np.ones(3), abs=1e-3)


def test_largest_component_is_kept() -> None:
    shift = torch.tensor([1.0, 0.0, 0.0])

    def field(x: Tensor) -> Tensor:
        return ((x + shift).norm(dim=1) - 0.7).minimum((x - shift).norm(dim=1) - 0.4)

    mesh = extract_surface(field, resolution=32, vertices=None, bounds=2.0)
    assert mesh.euler == 2
    assert mesh.vertices[:, 0].mean() == pytest.approx(-1, abs=0.02)


def torus(x: Tensor) -> Tensor:
    return torch.stack([x[:, :2].norm(dim=1) - 1, x[:, 2]], dim=1).norm(dim=1) - 0.4


def test_torus_is_refused_or_allowed() -> None:
    with pytest.raises(NotGenusZero, match=r"Euler characteristic 0; 2 is required"):
        extract_surface(torus, resolution=32, vertices=400, bounds=1.6)
    mesh = extract_surface(
        torus, resolution=32, vertices=400, bounds=1.6, require_genus_zero=False
    )
    assert mesh.euler == 0
    assert len(mesh.vertices) == 400


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (lambda x: x.norm(dim=1) + 1, r"between 1.* a change of sign is required"),
        (lambda x: x.norm(dim=1) - 9, r"a change of sign is required"),
        (lambda x: x[:, 0], r"leaves the box at \d+ places"),
        (lambda x: x[:, 0] * torch.nan, r"a change of sign is required"),
    ],
)
def test_no_usable_level_set(field: object, message: str) -> None:
    with pytest.raises(EmptyLevelSet, match=message):
        extract_surface(field, resolution=16, vertices=None, bounds=1.5)
