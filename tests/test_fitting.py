import numpy as np
import pytest

from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, unit
from gensp.methods.fitting import Known, NoFit, RegisterFit, SurfaceOnSphere, prolong

QUICK = {"schedule": [[10.0, 4], [1.0, 3], [0.1, 3]]}


NOTHING = Known(np.zeros(2), lambda p: p)


def image(level: int, stretch: float) -> SurfaceOnSphere:
    ball = icosphere(level)
    mesh = Mesh(ball.vertices * np.array([stretch, 1.0, 0.8]), ball.faces, "generated")
    return SurfaceOnSphere(mesh, ball.vertices)


def on_sphere(mesh: Mesh) -> SurfaceOnSphere:
    return SurfaceOnSphere(mesh, unit(mesh.vertices))


def test_no_fit_keeps_the_generated_surface(bumpy: Mesh) -> None:
    generated = image(3, 1.2)
    assert NoFit()(generated, bumpy, NOTHING) is generated


@pytest.mark.parametrize("level", [2, 3, 4])
def test_the_surface_comes_to_lie_on_the_shape(level: int, ellipsoid: Mesh) -> None:
    shape = normalize(ellipsoid)
    generated = image(level, 1.15)
    fitted = RegisterFit(level=3, registration=QUICK)(generated, shape, NOTHING)
    assert np.array_equal(fitted.mesh.faces, generated.mesh.faces)
    assert np.array_equal(fitted.sphere, generated.sphere)
    tree = ClosestPointTree(shape)
    before, after = (
        tree.query(surface.mesh.vertices).distance.mean() for surface in (generated, fitted)
    )
    assert after < 0.15 * before


def test_a_surface_that_fits_already_stays(ellipsoid: Mesh) -> None:
    shape = normalize(ellipsoid)
    fitted = RegisterFit(level=3, registration=QUICK)(on_sphere(shape), shape, NOTHING)
    np.testing.assert_allclose(fitted.mesh.vertices, shape.vertices, atol=1e-9)


def test_large_shapes_are_simplified_first(ellipsoid: Mesh) -> None:
    fine = icosphere(5)
    shape = normalize(Mesh(fine.vertices * np.array([1.5, 1, 0.7]), fine.faces, "fine"))
    fit = RegisterFit(vertices=600, level=3, registration=QUICK)
    fitted = fit(image(3, 1.15), shape, NOTHING)
    gap = ClosestPointTree(shape).query(fitted.mesh.vertices).distance
    assert gap.mean() < 0.01


def test_prolonged_positions_are_the_finer_icosphere_up_to_chords() -> None:
    coarse, fine = icosphere(2), icosphere(4)
    prolonged = prolong(coarse.vertices, len(fine.vertices))
    assert np.array_equal(prolonged[: len(coarse.vertices)], coarse.vertices)
    assert np.linalg.norm(unit(prolonged) - fine.vertices, axis=1).max() < 0.01
    assert np.array_equal(prolong(fine.vertices, len(fine.vertices)), fine.vertices)


def test_prolongation_keeps_linear_functions_of_an_unprojected_icosphere() -> None:
    # One step: every new vertex is the normalised midpoint of the edge whose mean it gets.
    coarse, fine = icosphere(3), icosphere(4)
    prolonged = prolong(coarse.vertices, len(fine.vertices))
    np.testing.assert_allclose(unit(prolonged), fine.vertices, atol=1e-14)
