"""Methods on the hierarchical embedding: bijective maps, each the best by its own measure."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from gensp.geometry.certificate import certify
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import minimise_map
from gensp.geometry.smat_energy import SmatEnergy
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_energy import SphericalEnergy
from gensp.methods.hierarchical import SmatPolish, ahsp, dirichlet, smat, stretch

METHODS = {"dirichlet": dirichlet, "stretch": stretch, "ahsp": ahsp, "smat": smat}


@pytest.fixture
def limbed():
    """A ball with two legs, as in conftest but coarse."""
    ball = icosphere(3)
    feet = unit(np.array([[0.4, 0.0, -1.0], [-0.4, 0.1, -1.0]]))
    squared = np.sum((ball.vertices[:, None] - feet) ** 2, axis=2)
    length = 2.5 * np.exp(-squared / 0.02).sum(axis=1)
    return Mesh(ball.vertices * (1 + length)[:, None], ball.faces, "limbed")


@pytest.fixture(params=METHODS)
def method(request):
    return METHODS[request.param]()


def test_map_is_certified_and_keeps_coordinates(method, limbed):
    moved = limbed.with_vertices(7 * limbed.vertices + 100)
    map = method(moved)
    np.testing.assert_array_equal(map.surface, moved.vertices)
    assert certify(map.sphere, map.faces)
    assert map.diagnostics["bad_faces"] == 0
    assert map.diagnostics["seconds"] > 0


def test_methods_travel_to_workers(method, bumpy):
    again = pickle.loads(pickle.dumps(method))
    np.testing.assert_array_equal(again(bumpy).sphere, method(bumpy).sphere)


def test_each_method_is_the_best_by_its_own_energy(limbed):
    shape = normalize(limbed)
    energies = {"smat": SmatEnergy(shape), "stretch": SphericalEnergy(shape, energy="stretch")}
    maps = {name: METHODS[name]()(limbed).sphere for name in METHODS}
    for name, energy in energies.items():
        values = {other: energy.energy(u) for other, u in maps.items()}
        assert min(values, key=values.__getitem__) == name


def test_sets_of_vertices_lead_to_the_minimum_that_newton_finds_elsewhere(bumpy):
    """From the Dirichlet map, Newton on smat's energy ends where smat does."""
    shape = normalize(bumpy)
    grown = replace(smat(), fine=SmatPolish(50, 50, decrement=1e-3))(shape)
    other = minimise_map(
        shape, dirichlet()(shape).sphere, SmatEnergy(shape), tolerance=0.0, decrement=1e-3
    )
    energy = SmatEnergy(shape).energy(grown.sphere)
    assert energy == pytest.approx(other.energy, rel=1e-5)
