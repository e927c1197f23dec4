"""Methods on the hierarchical embedding: bijective maps, each the best by its own measure."""

import pickle
import tempfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from slivers import slivers

from gensp.compiled.collapses import collapse_all
from gensp.compiled.energies import energy_slopes_of, energy_values_of
from gensp.compiled.fronts import extend_add
from gensp.compiled.growth import insert, sweep
from gensp.compiled.projection import raise_negative
from gensp.errors import NotEmbeddable
from gensp.geometry.certificate import certify
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import minimise_map
from gensp.geometry.progress import listening
from gensp.geometry.smat_energy import SmatEnergy
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_energy import SphericalEnergy
from gensp.geometry.spherical_map import load_map, save_map
from gensp.methods.hierarchical import SmatPolish, ahsp, compile_loops, dirichlet, smat, stretch
from gensp.methods.refinement import CertifiedRefinement

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


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.95), st.floats(0.0, 3.0))
@example(0, 0.0, 3.0)
def test_random_slivers_are_mapped_and_read_back_certified(seed, crowd, spread):
    map = dirichlet()(slivers(seed, crowd, spread))
    assert certify(map.sphere, map.faces)
    assert np.isfinite(map.distortion().max)
    with tempfile.TemporaryDirectory() as folder:
        save_map(map, folder)
        assert load_map(f"{folder}/{map.name}.npz").certify()


@settings(max_examples=6, deadline=None)
@given(
    st.sampled_from(["stretch", "ahsp"]),
    st.integers(0, 2**31),
    st.floats(0.0, 0.95),
    st.floats(0.0, 3.0),
)
@example("stretch", 0, 0.0, 3.0)
def test_no_method_folds_in_silence(name, seed, crowd, spread):
    """Energies that crowd what is small may find no place for a vertex, and say which."""
    mesh = slivers(seed, crowd, spread)
    try:
        map = METHODS[name]()(mesh)
    except NotEmbeddable as error:
        told = str(error)
    else:
        told = "" if certify(map.sphere, map.faces) else "folded"
    assert told == "" or "finds no place on the sphere in double precision" in told


def test_the_order_of_vertices_and_faces_changes_no_figure(limbed, rng):
    order = rng.permutation(len(limbed.vertices))
    faces = rng.permutation(np.argsort(order)[limbed.faces])
    shuffled = Mesh(limbed.vertices[order], faces, "shuffled")
    found = [dirichlet()(mesh).distortion() for mesh in (limbed, shuffled)]
    # Ties of the collapses are broken by the order; the minimum is the same.
    assert found[0].mean == pytest.approx(found[1].mean, rel=0.01)
    assert found[0].max == pytest.approx(found[1].max, rel=0.1)


def test_nothing_is_left_to_compile(limbed):
    """The seconds of the first map are those of any other."""
    compile_loops()
    assert compile_loops() < 0.01
    loops = (collapse_all, insert, sweep, energy_values_of, energy_slopes_of)
    loops += (raise_negative, extend_add)
    before = [loop.signatures for loop in loops]
    assert all(len(kinds) >= 1 for kinds in before)
    goals = unit(limbed.vertices)
    CertifiedRefinement(untangle_up_to=-1.0)(limbed, goals, goals, np.ones(len(goals)))
    turned = limbed.with_vertices(np.asfortranarray(limbed.vertices))
    for make in METHODS.values():
        make()(limbed)
        make()(turned)
    assert [loop.signatures for loop in loops] == before


def test_progress_is_told_to_who_listens(limbed):
    told: list[str] = []
    with listening(told.append):
        dirichlet()(limbed)
    count = len(told)
    assert told[0] == "collapsing the mesh"
    assert "growing the map: 642 of 642 vertices" in told
    assert any(line.startswith("Newton step 1 of at most 150, 642") for line in told)
    dirichlet()(limbed)
    assert len(told) == count


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
