import numpy as np
import pytest
import scipy.sparse

from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import ball_inversion, best_rotation
from gensp.geometry.descent import newton_step
from gensp.geometry.distortion import distortion
from gensp.geometry.mesh import normalize
from gensp.geometry.newton import minimise_map, refine_map
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_energy import SphericalEnergy


def _moebius_start(centre=(0.5, -0.3, 0.1)):
    return ball_inversion(icosphere(3).vertices, np.array(centre))


def test_a_matrix_that_lost_definiteness_still_gives_a_descent():
    hessian = scipy.sparse.csc_matrix([[1.0, 1 + 1e-9], [1 + 1e-9, 1.0]])
    gradient = np.array([1.0, -1.0])
    plain = -np.linalg.solve(hessian.toarray(), gradient)
    assert gradient @ plain > 0
    step, _ = newton_step(hessian, gradient, np.zeros((2, 3)))
    assert gradient @ step < 0
    sound = scipy.sparse.csc_matrix([[2.0, 1.0], [1.0, 3.0]])
    step, solver = newton_step(sound, gradient, np.zeros((2, 3)))
    np.testing.assert_allclose(sound @ step, -gradient, atol=1e-15)
    again, same = newton_step(2 * sound, gradient, np.zeros((2, 3)), solver)
    assert same is solver
    np.testing.assert_allclose(again, step / 2, atol=1e-15)
    with pytest.raises(np.linalg.LinAlgError, match="no step of descent"):
        newton_step(-sound, gradient, np.zeros((2, 3)))


def test_sphere_returns_to_its_identity():
    ball = normalize(icosphere(3))
    refined = refine_map(ball, _moebius_start(), tolerance=1e-10)
    assert refined.converged
    rotation = best_rotation(refined.sphere, unit(ball.vertices))
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(refined.sphere @ rotation.T, unit(ball.vertices), atol=5e-3)
    assert distortion(ball.vertices, refined.sphere, ball.faces).max < 1.02


def test_ellipsoid_from_a_moebius_start_has_less_energy_and_no_bad_face(ellipsoid):
    shape, start = normalize(ellipsoid), _moebius_start()
    refined = refine_map(shape, start)
    assert refined.energy < SphericalEnergy(shape).energy(start)
    assert not bad_faces(refined.sphere, shape.faces).any()
    assert map_degree(refined.sphere, shape.faces) == 1
    before = distortion(shape.vertices, start, shape.faces)
    after = distortion(shape.vertices, refined.sphere, shape.faces)
    assert after.max < before.max
    assert after.mean < 1.3 < before.mean


def test_minimum_does_not_depend_on_the_start(ellipsoid):
    shape = normalize(ellipsoid)
    ends = [
        refine_map(shape, start, tolerance=1e-11, max_iterations=100)
        for start in (_moebius_start(), unit(shape.vertices))
    ]
    assert ends[0].energy == pytest.approx(ends[1].energy, rel=1e-8)


def test_refinement_commutes_with_rotations(bumpy, rng):
    shape, start = normalize(bumpy), _moebius_start()
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    plain = refine_map(shape, start, pull=10.0, max_iterations=8)
    turned = refine_map(shape, start @ rotation.T, pull=10.0, max_iterations=8)
    np.testing.assert_allclose(turned.sphere, plain.sphere @ rotation.T, atol=1e-6)


def test_mirrored_start_stays_mirrored(bumpy):
    shape, start = normalize(bumpy), _moebius_start()
    plain = refine_map(shape, start, max_iterations=5)
    mirrored = refine_map(shape, -start, max_iterations=5)
    np.testing.assert_allclose(mirrored.sphere, -plain.sphere, atol=1e-9)


def test_pull_holds_the_map_at_its_target(bumpy):
    shape, start = normalize(bumpy), _moebius_start()
    target = unit(shape.vertices)

    def away(pull):
        refined = refine_map(shape, start, target=target, pull=pull, tolerance=1e-9)
        return np.linalg.norm(refined.sphere - target, axis=1).mean()

    weak, strong, stronger = away(1.0), away(100.0), away(1e5)
    assert weak > strong > stronger
    assert stronger < 1e-3


def test_pull_may_differ_from_vertex_to_vertex(bumpy):
    shape, target = normalize(bumpy), unit(bumpy.vertices)
    uniform = refine_map(shape, target, pull=20.0)
    array = refine_map(shape, target, pull=np.full(len(target), 20.0))
    np.testing.assert_array_equal(uniform.sphere, array.sphere)
    pins = np.where(target[:, 0] > 0, 1e5, 0.0)
    held = refine_map(shape, target, pull=pins, tolerance=1e-8)
    moved = np.linalg.norm(held.sphere - target, axis=1)
    assert moved[target[:, 0] > 0.1].max() < 0.1 * moved[target[:, 0] < -0.5].mean()


def test_triangle_weights_favour_their_triangles(bumpy):
    shape, start = normalize(bumpy), _moebius_start()
    left = shape.vertices[shape.faces].mean(axis=1)[:, 0] < 0
    plain = refine_map(shape, start, tolerance=1e-8)
    weighted = refine_map(shape, start, tolerance=1e-8, weights=np.where(left, 10.0, 1.0))

    def energy_on_the_left(sphere):
        return SphericalEnergy(shape, left.astype(float)).energy(sphere)

    assert energy_on_the_left(weighted.sphere) < energy_on_the_left(plain.sphere)


def test_folded_start_is_refused(bumpy):
    start = _moebius_start()
    start[7] = -start[7]
    with pytest.raises(NotEmbeddable, match=r"bumpy.*bad faces.*untangle"):
        refine_map(normalize(bumpy), start)


class _WithoutHessian(SphericalEnergy):
    """The derivatives of a map in which two vertices fall together are not finite."""

    def hessians(self, u, frames):
        return np.full((6, 6, len(self.faces)), np.nan)


def test_derivatives_that_are_not_finite_end_the_iteration():
    ball, start = normalize(icosphere(2)), icosphere(2).vertices
    refined = minimise_map(ball, start, _WithoutHessian(ball))
    assert not refined.converged
    np.testing.assert_array_equal(refined.sphere, unit(start))


def test_a_detour_is_held_where_the_start_was(bumpy):
    """Without a target the start pulls, also after the milder energy has moved the map away."""
    shape = normalize(bumpy)
    start = unit(shape.vertices)
    few = {"energy": "sigma", "pull": 30.0, "max_iterations": 2, "tolerance": 1e-12}
    direct = refine_map(shape, start, **few)
    held = refine_map(shape, start, detour=True, **few)
    told = refine_map(shape, start, target=start, detour=True, **few)
    assert not direct.converged
    assert held.energy < direct.energy
    np.testing.assert_array_equal(held.sphere, told.sphere)
