import numpy as np

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import refine_map
from gensp.geometry.shared_sphere import MetricEnergy, mean_squared_lengths, place_for_all
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_energy import SphericalEnergy, triangle_weights

PLACEMENT = {"energy": "sigma", "floor": 1.0}


def test_of_one_shape_the_mean_metric_is_its_own(bumpy: Mesh) -> None:
    shape = normalize(bumpy)
    u = unit(bumpy.vertices)
    squared = mean_squared_lengths(shape.vertices[None], shape.faces)
    shared = MetricEnergy(squared, shape.faces, len(u), floor=0.3)
    own = SphericalEnergy(shape, triangle_weights(shape, 0.3))
    np.testing.assert_allclose(shared.energy(u), own.energy(u), rtol=1e-12)
    np.testing.assert_allclose(shared.gradient(u), own.gradient(u), atol=1e-12)


def test_of_one_shape_the_placement_is_its_refined_map(bumpy: Mesh) -> None:
    shape = normalize(bumpy)
    u = unit(bumpy.vertices)
    placed = place_for_all(shape.vertices[None], shape.faces, u, **PLACEMENT)
    weights = triangle_weights(shape, 1.0)
    refined = refine_map(shape, u, weights=weights, energy="sigma", max_iterations=100)
    np.testing.assert_allclose(placed.energy, refined.energy, rtol=1e-9)


def test_stretches_that_cancel_leave_the_sphere(rng: np.random.Generator) -> None:
    ball = icosphere(3)
    # Along each axis one shape is long: their mean metric is nearly the sphere's.
    axes = np.eye(3) * 0.3 + 1
    images = np.stack([normalize(Mesh(ball.vertices * a, ball.faces)).vertices for a in axes])
    start = unit(ball.vertices + 0.02 * rng.standard_normal(ball.vertices.shape))
    placed = place_for_all(images, ball.faces, start, tolerance=1e-8, **PLACEMENT)
    u, _, vt = np.linalg.svd(placed.sphere.T @ ball.vertices)
    assert np.linalg.norm(placed.sphere @ (u @ vt) - ball.vertices, axis=1).max() < 0.03


def test_a_collapsed_triangle_does_not_rule(bumpy: Mesh) -> None:
    shape = normalize(bumpy)
    crushed = shape.vertices.copy()
    crushed[shape.faces[0]] = crushed[shape.faces[0]].mean(axis=0)
    both = np.stack([shape.vertices, crushed])
    placed = place_for_all(both, shape.faces, unit(bumpy.vertices), **PLACEMENT)
    assert np.isfinite(placed.energy)
    assert placed.converged
