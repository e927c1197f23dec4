"""Clouds, distance samples and their cache."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gensp.data.clouds import SurfaceSampler, point_cloud, sphere_cloud
from gensp.data.sdf import SdfSampler, cached_samples
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere

SAMPLER = SdfSampler(near=200, far=200, uniform=200)


def test_cloud_lies_on_the_surface_and_depends_on_content_alone(bumpy: Mesh) -> None:
    cloud = point_cloud(bumpy, 256)
    assert cloud.dtype == np.float32
    assert closest_point(cloud.astype(float), bumpy).distance.max() < 1e-6
    same = Mesh(bumpy.vertices.copy(), bumpy.faces.copy(), "other name")
    assert (point_cloud(same, 256) == cloud).all()
    assert not np.array_equal(point_cloud(same, 256, seed=1), cloud)
    moved = bumpy.with_vertices(bumpy.vertices * 1.001)
    assert not np.allclose(point_cloud(moved, 256), cloud, atol=0.01)


def test_cloud_of_the_sphere_is_exact_and_fixed() -> None:
    cloud = sphere_cloud(500)
    assert np.abs(np.linalg.norm(cloud, axis=1) - 1).max() < 1e-6
    assert np.abs(cloud.mean(axis=0)).max() < 0.15
    assert (sphere_cloud(500) == cloud).all()


def test_surface_sampler_is_area_uniform(dumbbell: Mesh) -> None:
    sampler = SurfaceSampler.of(dumbbell)
    points = sampler.draw(20_000, torch.Generator().manual_seed(0)).numpy().astype(float)
    assert closest_point(points, dumbbell).distance.max() < 1e-5
    right = dumbbell.vertices[dumbbell.faces].mean(axis=1)[:, 0] > 1.2
    share = dumbbell.face_areas[right].sum() / dumbbell.area
    assert (points[:, 0] > 1.2).mean() == pytest.approx(share, abs=0.03)
    again = sampler.draw(20_000, torch.Generator().manual_seed(0)).numpy()
    assert (again == points.astype(np.float32)).all()


def test_samples_of_an_icosphere_have_the_distance_of_the_sphere() -> None:
    samples = SAMPLER(normalize(icosphere(5)), 1.5)
    exact = np.linalg.norm(samples.points.astype(float), axis=1) - 1
    assert np.abs(samples.distances - exact).max() < 2e-3
    assert (samples.distances[np.abs(exact) > 0.01] < 0).any()
    near, far, uniform = np.split(np.abs(samples.distances), [200, 400])
    assert near.std() < 0.02
    assert 0.04 < far.std() < 0.1
    assert uniform.max() > 0.5
    assert np.abs(samples.points).max() <= 1.5


def test_samples_of_the_sphere_are_exact() -> None:
    samples = SAMPLER.of_sphere(1.5)
    assert samples.points.shape == (600, 3)
    exact = np.linalg.norm(samples.points.astype(float), axis=1) - 1
    assert np.abs(samples.distances - exact).max() < 1e-7


def test_inside_is_negative_on_a_concave_shape(dumbbell: Mesh) -> None:
    samples = SAMPLER(normalize(dumbbell), 2.0)
    scale = np.sqrt(4 * np.pi / dumbbell.area)
    x = samples.points[:, 0] / (2 * scale)
    waist = (0.25 + 0.75 * x**2) * np.sqrt(np.clip(1 - x**2, 0, None)) * scale
    depth = waist - np.linalg.norm(samples.points[:, 1:], axis=1)
    clear = np.abs(depth) > 0.03
    inside = (depth > 0) & (np.abs(x) < 1)
    assert ((samples.distances < 0) == inside)[clear].all()


def test_cache_is_read_back(tmp_path: Path, bumpy: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    first = cached_samples(bumpy, SAMPLER, 1.5, tmp_path)

    def fail(*_: object) -> None:
        raise AssertionError("sampled although cached")

    monkeypatch.setattr(SdfSampler, "__call__", fail)
    again = cached_samples(bumpy, SAMPLER, 1.5, tmp_path)
    assert (again.points == first.points).all()
    assert (again.distances == first.distances).all()


@pytest.mark.parametrize("damage", ["truncate", "text", "values"])
def test_damaged_cache_is_made_again_with_a_warning(
    tmp_path: Path, bumpy: Mesh, damage: str
) -> None:
    first = cached_samples(bumpy, SAMPLER, 1.5, tmp_path)
    (path,) = tmp_path.glob("*/*.npz")
    if damage == "truncate":
        path.write_bytes(path.read_bytes()[:500])
    elif damage == "text":
        path.write_text("not an archive")
    else:
        np.savez(path, points=first.points, distances=first.distances + 1, digest="0")
    with pytest.warns(UserWarning, match=r"damaged; bumpy is sampled again"):
        again = cached_samples(bumpy, SAMPLER, 1.5, tmp_path)
    assert (again.distances == first.distances).all()
    assert len(list(tmp_path.iterdir())) == 1


def test_other_settings_have_another_place(tmp_path: Path, bumpy: Mesh) -> None:
    cached_samples(bumpy, SAMPLER, 1.5, tmp_path)
    cached_samples(bumpy, SAMPLER, 1.6, tmp_path)
    cached_samples(bumpy, SdfSampler(near=201, far=200, uniform=200), 1.5, tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_thin_places_are_sampled_more_densely_where_asked(dumbbell: Mesh) -> None:
    def share_at_neck(thinness: float) -> float:
        sampler = SdfSampler(near=4000, near_deviation=0.0, far=0, uniform=0, thinness=thinness)
        return float((np.abs(sampler(dumbbell, 1.5).points[:, 0]) < 0.3).mean())

    centres = dumbbell.vertices[dumbbell.faces].mean(axis=1)
    neck = dumbbell.face_areas[np.abs(centres[:, 0]) < 0.3].sum() / dumbbell.area
    assert share_at_neck(0.0) == pytest.approx(neck, abs=0.02)
    assert share_at_neck(1.0) > 1.5 * neck
