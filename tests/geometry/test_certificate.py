"""What certifies a map, and what each kind of map that is not bijective lacks."""

import numpy as np
import pytest
from test_predicates import double_cover
from test_topology import BALL, BROKEN

from gensp.errors import NotEmbeddable, UnreadableMesh
from gensp.geometry.certificate import certify, place_of, require_bijective
from gensp.geometry.sphere import unit
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map


def broken(name: str) -> SphericalMap:
    """A map with unfolded faces whose surface is no sphere."""
    faces, count, _ = BROKEN[name]
    sphere = np.resize(BALL.vertices, (count, 3))
    return SphericalMap(sphere, sphere, faces, name)


SAME_FACES = ("missing", "repeated", "island", "unused")


@pytest.mark.parametrize("name", SAME_FACES)
def test_a_surface_that_is_not_closed_is_not_certified(name):
    map = broken(name)
    found = map.certify()
    assert len(found.faults) == 0
    assert not found.bijective
    assert found.degree is None
    assert BROKEN[name][2] in found.topology
    assert BROKEN[name][2] in str(found)


@pytest.mark.parametrize("name", SAME_FACES)
def test_nor_is_its_file_read(name, tmp_path):
    save_map(broken(name), tmp_path)
    with pytest.raises(UnreadableMesh) as caught:
        load_map(tmp_path / f"{name}.npz")
    line = str(caught.value)
    assert BROKEN[name][2] in line
    assert "; a map of one closed surface of genus 0 is required; write it again" in line


def test_faces_of_vertices_that_do_not_exist_are_at_fault():
    faces, count, told = BROKEN["outside"]
    found = certify(BALL.vertices, faces)
    wrong = (faces >= count).any(axis=1)
    np.testing.assert_array_equal(found.faults, np.flatnonzero(wrong))
    assert told in found.topology


def test_a_branched_cover_has_no_fault_but_its_degree():
    """Around the poles every face keeps its orientation, and the map winds twice."""
    sphere, faces = double_cover()
    found = certify(sphere, faces)
    assert (len(found.faults), found.topology, found.degree) == (0, "", 2)
    assert not found
    assert "degree 2" in str(found)


def test_a_mirrored_map_says_its_degree():
    found = certify(BALL.vertices * [1, 1, -1], BALL.faces)
    assert found
    assert "degree -1, orientation mirrored" in str(found)
    with pytest.raises(
        NotEmbeddable, match="sphere: the map has degree -1; a bijective map of deg"
    ):
        require_bijective(BALL, BALL.vertices * [1, 1, -1], remedy="turn it")


def test_a_fold_is_refused_with_its_place():
    folded = BALL.vertices.copy()
    folded[7] = -folded[7]
    first = int(certify(folded, BALL.faces).faults[0])
    with pytest.raises(NotEmbeddable) as caught:
        require_bijective(BALL, folded, remedy="remesh it")
    assert f"(first: {place_of(BALL, first)}); a bijective" in str(caught.value)
    assert str(caught.value).endswith("; remesh it")
    require_bijective(BALL, unit(BALL.vertices * [1, 2, 3]), remedy="")


def test_a_place_is_in_the_middle_of_its_face():
    moved = BALL.with_vertices(100 * BALL.vertices)
    place = place_of(moved, 3)
    assert place.startswith("face 3 near [")
    middle = np.array(place.split("[")[1].rstrip("]").split(", "), float)
    np.testing.assert_allclose(middle, moved.vertices[moved.faces[3]].mean(axis=0), rtol=1e-3)
