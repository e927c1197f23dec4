from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slivers import slivers

from gensp.compiled.halfedges import collapse, ring, split
from gensp.geometry.alignment import best_rotation, normal_rotation
from gensp.geometry.certificate import certify
from gensp.geometry.decimation import HalfEdges, decimate
from gensp.geometry.distortion import distortion
from gensp.geometry.embedding import Schedule, embed
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import refine_map
from gensp.geometry.sphere import icosphere, unit


@pytest.fixture
def limbed():
    """A ball with five long thin legs, where conformal maps underflow."""
    return legged(level=4, length=5.0)


def legged(level, length):
    ball = icosphere(level)
    u = ball.vertices
    feet = unit(np.array([[1, 1, 0.2], [-1, 1, 0.1], [1, -1, 0], [-1, -1, -0.3], [0, 0.2, 1]]))
    bump = sum(np.exp(-(((1 - u @ foot) / 0.02) ** 2)) for foot in feet)
    return normalize(Mesh(u * (1 + length * bump)[:, None], ball.faces, "legged"))


def test_ring_turns_counter_clockwise():
    ball = icosphere(1)
    edges = HalfEdges.of(ball.faces, len(ball.vertices))
    around = np.empty(len(ball.vertices), dtype=np.int64)
    for v in range(len(ball.vertices)):
        size = ring(edges.leaving[v], edges.origin, edges.twin, around)
        u, rim = ball.vertices[v], ball.vertices[around[:size]]
        assert size == (5 if v < 12 else 6)
        turns = np.einsum("i,ki->k", u, np.cross(rim - u, np.roll(rim, -1, axis=0) - u))
        assert (turns > 0).all()


def test_splits_undo_collapses(bumpy):
    before = HalfEdges.of(bumpy.faces, len(bumpy.vertices))
    found = decimate(normalize(bumpy))
    edges = found.halfedges
    assert len(found.order) == len(bumpy.vertices) - 4
    assert len(np.unique(edges.origin[found.order])) == len(found.order)
    for h in found.order[::-1]:
        split(h, edges.origin, edges.twin, edges.leaving)
    np.testing.assert_array_equal(edges.origin, before.origin)
    np.testing.assert_array_equal(edges.twin, before.twin)
    np.testing.assert_array_equal(edges.origin[edges.leaving], np.arange(len(bumpy.vertices)))


def test_sets_of_collapses_are_independent(bumpy):
    """No neighbour of a vertex that has gone goes in the same set, and sets are large."""
    mesh = normalize(bumpy)
    found = decimate(mesh, "smat")
    left = np.array([*found.sizes[::-1]])
    assert left[-1] == 4
    assert (np.diff(left) < 0).all()
    bounds = [0, *(len(mesh.vertices) - left)]
    for first, last in pairwise(bounds):
        faces = _collapsed(mesh, found, first)
        gone = found.halfedges.origin[found.order[first:last]]
        sides = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        assert not np.isin(sides, gone).all(axis=1).any()
    assert left[0] < 0.85 * len(mesh.vertices)
    other = decimate(mesh)
    assert other.sizes == (4,)
    assert not np.array_equal(other.order, found.order)


def _collapsed(mesh, found, count):
    """Faces after the first `count` collapses."""
    edges = HalfEdges.of(mesh.faces, len(mesh.vertices))
    for h in found.order[:count]:
        collapse(h, edges.origin, edges.twin, edges.leaving)
    alive = np.ones(len(mesh.faces), dtype=bool)
    gone = found.order[:count]
    alive[gone // 3] = alive[edges.twin[gone] // 3] = False
    return edges.origin.reshape(-1, 3)[alive]


def test_collapse_keeps_a_closed_triangulation():
    ball = icosphere(1)
    edges = HalfEdges.of(ball.faces, len(ball.vertices))
    collapse(0, edges.origin, edges.twin, edges.leaving)
    gone = np.array([0, edges.twin[0]]) // 3
    faces = np.delete(edges.origin.reshape(-1, 3), gone, axis=0)
    assert len(np.unique(faces)) == len(ball.vertices) - 1
    assert Mesh(ball.vertices, faces).euler == 2


def test_sphere_is_embedded_almost_isometrically():
    ball = normalize(icosphere(4))
    u = embed(ball)
    assert certify(u, ball.faces)
    assert distortion(ball.vertices, u, ball.faces).mean < 1.05
    # Up to a rotation it is the identity.
    turned = u @ best_rotation(u, ball.vertices).T
    assert np.linalg.norm(turned - unit(ball.vertices), axis=1).max() < 0.2


@pytest.mark.parametrize("energy", ["dirichlet", "stretch", "amips", "sigma"])
def test_thin_legs_are_embedded_without_folds(limbed, energy):
    u = embed(limbed, schedule=Schedule(energy=energy))
    assert certify(u, limbed.faces)
    assert distortion(limbed.vertices, u, limbed.faces).max < 100


def test_energies_minimise_what_they_name(limbed):
    """Stretch of the stretch map is below that of the Dirichlet map, and the other way round."""
    from gensp.geometry.spherical_energy import SphericalEnergy

    maps = {
        energy: embed(limbed, schedule=Schedule(energy=energy, floor=0.0, passes=20))
        for energy in ("dirichlet", "stretch")
    }
    for energy, u in maps.items():
        measure = SphericalEnergy(limbed, energy=energy)
        other = maps["stretch" if energy == "dirichlet" else "dirichlet"]
        assert measure.energy(u) < measure.energy(other)


def test_coarse_to_fine_agrees_with_newton_from_elsewhere(bumpy):
    """Two routes to one minimum: the embedding, and Newton from the radial map."""
    shape = normalize(bumpy)
    radial = refine_map(shape, unit(shape.vertices), tolerance=1e-7)
    grown = refine_map(shape, embed(shape), tolerance=1e-7)
    assert grown.energy == pytest.approx(radial.energy, rel=1e-4)


def test_embedding_does_not_depend_on_pose_or_size(limbed, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    turned = limbed.with_vertices(limbed.vertices @ rotation.T)
    values = [distortion(m.vertices, embed(m), m.faces).mean for m in (limbed, turned)]
    # Ties of the collapses are broken by rounding; the minimum is the same.
    assert values[0] == pytest.approx(values[1], rel=0.03)


def test_target_guides_the_embedding(limbed):
    free = refine_map(limbed, embed(limbed)).sphere
    target = free[:, [1, 2, 0]]  # a third of a turn
    guided = embed(limbed, target=target, pull=30.0)
    assert certify(guided, limbed.faces)
    assert np.linalg.norm(guided - target, axis=1).mean() < 0.1
    assert np.linalg.norm(guided - free, axis=1).mean() > 0.5


def test_folded_target_is_followed_where_it_is_trusted(limbed, rng):
    """Half of the target is noise without weight; the rest is met all the same."""
    target = refine_map(limbed, embed(limbed)).sphere
    trusted = target[:, 0] > 0
    noisy = np.where(trusted[:, None], target, unit(rng.standard_normal(target.shape)))
    guided = embed(limbed, target=noisy, pull=np.where(trusted, 30.0, 0.0))
    assert certify(guided, limbed.faces)
    assert np.linalg.norm(guided - target, axis=1)[trusted].mean() < 0.1


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**31), st.floats(-6.0, -1.0), st.floats(0.0, 6.0), st.integers(0, 3))
def test_random_slivers_and_area_ratios_are_embedded(seed, flat, ratio, limbs):
    mesh = slivers(seed, flat=10**flat, ratio=10**ratio, limbs=limbs)
    assert certify(embed(mesh), mesh.faces)


def test_polish_is_handed_coarse_meshes_of_full_area(limbed):
    seen = []

    def polish(coarse, u, vertices):
        assert certify(u, coarse.faces)
        assert coarse.area == pytest.approx(4 * np.pi)
        np.testing.assert_allclose(unit(coarse.vertices), unit(limbed.vertices[vertices]))
        seen.append(len(u))
        return u

    embed(limbed, schedule=Schedule(polish=(100, 1000)), polish=polish)
    assert seen == [100, 1000]
    seen.clear()
    embed(limbed, schedule=Schedule(polish="sets", priority="smat"), polish=polish)
    assert tuple(seen) == decimate(limbed, "smat").sizes[1:]


def test_normal_rotation_undoes_a_rotation(ellipsoid, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    u = unit(ellipsoid.vertices)
    first = u @ normal_rotation(u, ellipsoid).T
    second = u @ rotation.T
    second = second @ normal_rotation(second, ellipsoid).T
    np.testing.assert_allclose(first, second, atol=1e-10)


def test_certificate_names_the_faces_at_fault(bumpy):
    u = unit(bumpy.vertices)
    good = certify(u, bumpy.faces)
    assert good
    assert good.degree == good.orientation == 1
    mirrored = certify(u * [1, 1, -1], bumpy.faces)
    assert mirrored
    assert mirrored.degree == mirrored.orientation == -1
    folded = u.copy()
    folded[7] = -folded[7]
    bad = certify(folded, bumpy.faces)
    assert not bad
    assert set(bad.faults) <= set(np.flatnonzero((bumpy.faces == 7).any(axis=1)))
    assert "not bijective" in str(bad)
