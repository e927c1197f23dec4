import numpy as np
import pytest

from gensp.geometry.assembly import HessianPattern
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import minimise_map
from gensp.geometry.smat_energy import SmatEnergy
from gensp.geometry.sphere import icosphere, tangent_frame, unit

WEIGHTS = [{}, {"barrier": 1.0, "angle": 0.0, "area": 0.0}, {"angle": 0.0, "area": 5.0}]


@pytest.fixture
def shape(bumpy):
    return normalize(bumpy)


@pytest.fixture
def start():
    ball = icosphere(3).vertices
    return unit(ball + 0.15 * np.sin(3 * ball[:, [1, 2, 0]]))


def test_energy_of_a_regular_octahedron_on_itself():
    """Corners of 90° on the sphere and 60° on the surface, arcs of 90°, equal areas."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    grown = np.sqrt(3) / 2 * 8 / (4 * np.pi)  # the chordal octahedron is smaller than the sphere
    expected = 8 * (
        -np.log(1 / 6)
        - 3 * np.log(np.deg2rad(50))
        + 100 * 3 * (1.5**2 + 1.5**-2)
        + grown**2
        + grown**-2
    )
    found = SmatEnergy(Mesh(7 * corners, faces)).energy(corners)
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_gradient_against_finite_differences(shape, start, rng, weights):
    energy, h = SmatEnergy(shape, **weights), 1e-6
    for _ in range(3):
        moving = np.einsum("nik,nk->ni", tangent_frame(start), rng.standard_normal((642, 2)))
        values = [energy.energy(unit(start + s * moving)) for s in (h, -h)]
        slope = (values[0] - values[1]) / (2 * h)
        assert np.sum(energy.gradient(start) * moving) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_hessian_against_finite_differences_of_the_gradient(shape, start, rng, weights):
    energy, frames, h = SmatEnergy(shape, **weights), tangent_frame(start), 1e-6
    blocks = energy.hessians(start, frames)
    matrix = HessianPattern(shape.faces, len(start)).assemble(blocks, np.zeros(2 * len(start)))
    x = rng.standard_normal((len(start), 2))
    along = np.einsum("nik,nk->ni", frames, x)

    def slope(step):
        u = unit(start + step * along)
        length = np.linalg.norm(start + step * along, axis=1, keepdims=True)
        velocity = (along - np.sum(along * u, axis=1, keepdims=True) * u) / length
        return np.sum(energy.gradient(u) * velocity)

    second = (slope(h) - slope(-h)) / (2 * h)
    assert x.reshape(-1) @ (matrix @ x.reshape(-1)) == pytest.approx(second, rel=1e-5)
    np.testing.assert_allclose(blocks, blocks.swapaxes(0, 1), atol=1e-10 * np.abs(blocks).max())


def test_energy_is_invariant_under_rotation_and_size(shape, start, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    energy, larger = SmatEnergy(shape), SmatEnergy(shape.with_vertices(3 * shape.vertices))
    turned = start @ rotation.T
    assert energy.energy(turned) == pytest.approx(energy.energy(start), rel=1e-12)
    assert larger.energy(start) == pytest.approx(energy.energy(start), rel=1e-12)
    gradient = energy.gradient(start)
    np.testing.assert_allclose(
        energy.gradient(turned), gradient @ rotation.T, atol=1e-9 * np.abs(gradient).max()
    )


def test_folded_map_has_infinite_energy(shape, start):
    start[0] = -start[0]
    assert SmatEnergy(shape).energy(start) == np.inf


def test_newton_reaches_one_minimum_from_two_starts(shape, start):
    radial = minimise_map(shape, unit(shape.vertices), SmatEnergy(shape), tolerance=1e-9)
    moved = minimise_map(shape, start, SmatEnergy(shape), tolerance=1e-9)
    assert radial.converged
    assert moved.converged
    assert moved.energy == pytest.approx(radial.energy, rel=1e-7)
    slope = SmatEnergy(shape).gradient(moved.sphere)
    tangential = np.einsum("nik,ni->nk", tangent_frame(moved.sphere), slope)
    before = np.einsum("nik,ni->nk", tangent_frame(start), SmatEnergy(shape).gradient(start))
    assert np.abs(tangential).max() < 1e-3 * np.abs(before).max()
