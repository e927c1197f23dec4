"""The random meshes are what they are said to be."""

import numpy as np
import pytest
from scipy.optimize import linprog
from slivers import SLIVERS, slivers, winding

from gensp.geometry.mesh import Mesh, require_genus_zero
from gensp.geometry.sphere import icosphere

SEEDS = range(6)


def flatness(mesh: Mesh) -> np.ndarray:
    """Height over longest side of every triangle."""
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return 2 * mesh.face_areas / sides.max(axis=1) ** 2


def depth_of_kernel(mesh: Mesh) -> float:
    """How far a point can stay below the planes of all faces; negative if none is below."""
    normals = mesh.face_normals
    heights = np.einsum("mi,mi->m", normals, mesh.vertices[mesh.faces[:, 0]])
    below = np.column_stack([normals, np.ones(len(normals))])
    return float(linprog([0, 0, 0, -1], below, heights, bounds=(None, None)).x[3])


@pytest.mark.parametrize("limbs", [0, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_hard_meshes_are_sound_with_slivers_and_ratios(seed: int, limbs: int) -> None:
    mesh = slivers(seed, limbs=limbs)
    require_genus_zero(mesh)
    flat, areas = flatness(mesh), mesh.face_areas
    slim = flat < 3e-6
    assert slim.sum() >= 2 * SLIVERS
    assert 1e-7 < flat.min() < 1e-6
    assert 5e5 < areas.max() / areas.min() < 2e6
    assert areas.max() / areas[~slim].min() > 4e5


@pytest.mark.parametrize("seed", SEEDS)
def test_easy_meshes_have_neither(seed: int) -> None:
    mesh = slivers(seed, flat=0.1, ratio=1.0, limbs=0)
    require_genus_zero(mesh)
    assert flatness(mesh).min() > 1e-3
    assert mesh.face_areas.max() / mesh.face_areas.min() < 1e4


def test_triangles_are_those_of_no_icosphere_and_differ() -> None:
    meshes = [slivers(seed) for seed in SEEDS]
    for mesh in meshes:
        degrees = np.bincount(mesh.faces.reshape(-1))
        assert degrees.min() == 3
        assert degrees.max() >= 9
    assert len({str(np.sort(np.bincount(mesh.faces.reshape(-1)))) for mesh in meshes}) == len(
        SEEDS
    )
    np.testing.assert_array_equal(slivers(0).vertices, meshes[0].vertices)


@pytest.mark.parametrize("seed", SEEDS)
def test_limbs_hang_over(seed: int) -> None:
    """A ball is seen as a whole from its middle; a body with winding limbs from nowhere."""
    assert depth_of_kernel(icosphere(2)) == pytest.approx(0.98, abs=0.02)
    assert depth_of_kernel(winding(0, np.random.default_rng(seed))) > 0
    for mesh in (winding(3, np.random.default_rng(seed)), slivers(seed)):
        assert depth_of_kernel(mesh) < -0.4 * np.sqrt(mesh.area / (4 * np.pi))
