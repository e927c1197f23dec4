import numpy as np
import pytest

from gensp.compiled.energies import ENERGIES, energy_slopes, energy_value
from gensp.geometry.assembly import HessianPattern
from gensp.geometry.distortion import singular_values
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, sample_sphere, tangent_frame, unit
from gensp.geometry.spherical_energy import (
    SphericalEnergy,
    project_positive,
    triangle_weights,
)


@pytest.fixture
def shape(bumpy):
    return normalize(bumpy)


@pytest.fixture
def start():
    ball = icosphere(3).vertices
    return unit(ball + 0.15 * np.sin(3 * ball[:, [1, 2, 0]]))


@pytest.fixture(params=sorted(ENERGIES))
def energy(shape, rng, request):
    return SphericalEnergy(shape, rng.uniform(0.5, 2, len(shape.faces)), request.param)


def _along(u, x, step):
    return unit(u + step * np.einsum("nik,nk->ni", tangent_frame(u), x))


def test_energy_of_the_identity_is_twice_the_area():
    for level in (2, 4):
        ball = icosphere(level)
        energy = SphericalEnergy(ball).energy(ball.vertices)
        # ‖J‖² = 2 and ‖J⁻¹‖² ≈ 2 as the determinants tend to twice the areas.
        assert energy == pytest.approx(4 * ball.area, rel=2 / 4**level)


def test_identity_is_a_minimiser_of_the_sphere(rng):
    ball = normalize(icosphere(3))
    energy = SphericalEnergy(ball)
    u, frames = unit(ball.vertices), tangent_frame(unit(ball.vertices))
    gradient = np.einsum("nik,ni->nk", frames, energy.gradient(u))
    # The chord against the arc leaves a discretisation error of the order of the face size.
    lumped = 4 * np.pi / len(u)
    assert np.abs(gradient).max() < 0.1 * lumped
    identity = energy.energy(u)
    for scale in (0.01, 0.05):
        moved = unit(u + scale * np.sin(2 * u[:, [1, 2, 0]] + rng.uniform(0, 6, 3)))
        assert energy.energy(moved) > identity


def test_energy_agrees_with_the_singular_values(shape, start):
    values = singular_values(shape.vertices, start, shape.faces)
    sphere_area = Mesh(start, shape.faces).area
    # The distortion measure scales the chordal sphere to 4π; the energy takes it as it is.
    values = values * np.sqrt(sphere_area / (4 * np.pi))
    expected = shape.face_areas @ (np.sum(values**2, axis=1) + np.sum(values**-2.0, axis=1))
    assert SphericalEnergy(shape).energy(start) == pytest.approx(expected, rel=0.02)


def test_gradient_against_finite_differences(energy, start, rng):
    for _ in range(3):
        x = rng.standard_normal((len(start), 2))
        moving = np.einsum("nik,nk->ni", tangent_frame(start), x)
        h = 1e-6
        slope = (energy.energy(_along(start, x, h)) - energy.energy(_along(start, x, -h))) / (
            2 * h
        )
        assert np.sum(energy.gradient(start) * moving) == pytest.approx(slope, rel=1e-6, abs=1e-5)


def test_hessian_against_finite_differences_of_the_gradient(energy, shape, start, rng):
    frames = tangent_frame(start)
    blocks = energy.hessians(start, frames)
    matrix = HessianPattern(shape.faces, len(start)).assemble(blocks, np.zeros(2 * len(start)))
    x, y = rng.standard_normal((2, len(start), 2))
    h = 1e-5

    def slope_along_x(step):
        # d/ds E(retraction of s x) at s = step; with y in place of x by polarisation below.
        u = start + step * np.einsum("nik,nk->ni", frames, x)
        length = np.linalg.norm(u, axis=1, keepdims=True)
        u = u / length
        velocity = np.einsum("nik,nk->ni", frames, x)
        velocity = (velocity - np.sum(velocity * u, axis=1, keepdims=True) * u) / length
        return np.sum(energy.gradient(u) * velocity)

    second = (slope_along_x(h) - slope_along_x(-h)) / (2 * h)
    assert x.reshape(-1) @ (matrix @ x.reshape(-1)) == pytest.approx(second, rel=1e-6)
    assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    assert x.reshape(-1) @ (matrix @ y.reshape(-1)) == pytest.approx(
        y.reshape(-1) @ (matrix @ x.reshape(-1))
    )


def test_energy_is_invariant_under_rotation(energy, start, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    assert energy.energy(start @ rotation.T) == pytest.approx(energy.energy(start), rel=1e-12)
    turned = energy.gradient(start @ rotation.T)
    np.testing.assert_allclose(turned, energy.gradient(start) @ rotation.T, atol=1e-10)


def test_folded_map_has_infinite_energy(energy, start):
    folded = start.copy()
    folded[0] = -folded[0]
    assert energy.energy(folded) == np.inf


def test_projection_keeps_positive_parts_only(energy, start, rng):
    blocks = energy.hessians(start, tangent_frame(start))
    projected = np.moveaxis(project_positive(blocks), 2, 0)
    values = np.linalg.eigvalsh(projected)
    assert values.min() > -1e-10 * values.max()
    original = np.linalg.eigvalsh(np.moveaxis(blocks, 2, 0))
    np.testing.assert_allclose(values, np.maximum(original, 0), atol=1e-10 * values.max())
    assert original.min() < -1e-3  # the projection has something to do


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e300])
def test_projection_agrees_with_lapack(rng, size):
    blocks = rng.standard_normal((6, 6, 200))
    blocks += blocks.swapaxes(0, 1)
    blocks[..., 0] = 0  # no direction
    blocks[..., 1] = np.eye(6)
    blocks[..., 2] = np.diag([1, -1, 2, 0, -3, 4])
    blocks[..., 3] = 1  # one eigenvalue, and five of zero
    blocks[..., 4:20] *= np.geomspace(1e-12, 1, 16)
    grades = 10.0 ** rng.integers(-40, 1, (6, 6, 100))
    blocks[..., 20:120] *= np.maximum(grades, grades.swapaxes(0, 1))
    blocks[..., 120] = np.diag([0.5, -0.3, -0.2, -0.1, 0.4, -0.6])
    blocks[0, 1, 120] = blocks[1, 0, 120] = 1.0
    blocks[0, 2, 120] = blocks[2, 0, 120] = 1e-8  # of no weight in the norm of its column
    blocks[..., 121] = 0
    blocks[0, 0, 121], blocks[1, 2, 121], blocks[2, 1, 121] = 1.0, 1e-170, 1e-170
    values, vectors = np.linalg.eigh(np.moveaxis(blocks, 2, 0))
    expected = (vectors * np.maximum(values, 0)[:, None]) @ vectors.swapaxes(1, 2)
    found = np.moveaxis(project_positive(size * blocks) / size, 2, 0)
    assert np.linalg.eigvalsh(found).min() > -1e-13
    scale = np.maximum(np.abs(values).max(axis=1), 1e-300)[:, None, None]
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-14)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_projection_refuses_what_is_no_number(value):
    blocks = np.zeros((6, 6, 3))
    blocks[2, 3, 1] = blocks[3, 2, 1] = value
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        project_positive(blocks)


def test_assembly_agrees_with_a_coordinate_list(rng):
    mesh = icosphere(1)
    count = len(mesh.vertices)
    blocks = rng.standard_normal((6, 6, len(mesh.faces)))
    diagonal = rng.standard_normal(2 * count)
    dense = np.diag(diagonal)
    unknowns = (2 * mesh.faces[:, :, None] + np.arange(2)).reshape(-1, 6)
    for t, unknown in enumerate(unknowns):
        dense[np.ix_(unknown, unknown)] += blocks[:, :, t]
    matrix = HessianPattern(mesh.faces, count).assemble(blocks, diagonal)
    assert matrix.has_canonical_format
    np.testing.assert_allclose(matrix.toarray(), dense, atol=1e-13)


def test_determinant_keeps_its_sign_on_tiny_triangles():
    centre = sample_sphere(1, np.random.default_rng(3))[0]
    frame = tangent_frame(centre[None])[0]
    u = unit(centre + 1e-9 * np.array([[0, 0], [1.0, 0], [0, 1.0]]) @ frame.T)
    faces = np.array([[0, 1, 2]])
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), faces)
    assert np.isfinite(SphericalEnergy(flat).energy(u))
    assert SphericalEnergy(flat).energy(u[[0, 2, 1]]) == np.inf


@pytest.mark.parametrize("name", sorted(ENERGIES))
def test_slopes_of_an_energy_are_its_derivatives(name, rng):
    kind, h = ENERGIES[name], 1e-5

    def difference(of, along, d, j):
        a, b = h * along[0], h * along[1]
        return (np.array(of(kind, d + a, j + b)) - np.array(of(kind, d - a, j - b))) / (2 * h)

    for d, j in zip(rng.uniform(2.5, 9, 20), rng.uniform(0.3, 1.2, 20), strict=True):
        fd, fj, fdd, fdj, fjj = energy_slopes(kind, d, j)
        for along, first, second in (((1, 0), fd, (fdd, fdj)), ((0, 1), fj, (fdj, fjj))):
            assert difference(energy_value, along, d, j) == pytest.approx(first, rel=1e-5)
            slopes = difference(energy_slopes, along, d, j)[:2]
            np.testing.assert_allclose(slopes, second, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", sorted(ENERGIES))
def test_folded_triangles_cost_without_bound(name):
    kind = ENERGIES[name]
    assert energy_value(kind, 4.0, 0.0) == np.inf
    assert energy_value(kind, 4.0, -0.1) == np.inf
    assert energy_value(kind, 4.0, 1e-3) > 100 * energy_value(kind, 2.0, 1.0)


def test_weights_lift_small_triangles_to_the_floor(shape):
    weights = triangle_weights(shape, 0.5)
    weighted = weights * shape.face_areas
    assert weighted.min() == pytest.approx(0.5 * shape.face_areas.mean())
    large = shape.face_areas >= 0.5 * shape.face_areas.mean()
    np.testing.assert_array_equal(weights[large], 1)
    assert np.ptp(triangle_weights(shape, 1e6) * shape.face_areas) < 1e-6 * weighted.max() * 1e6
