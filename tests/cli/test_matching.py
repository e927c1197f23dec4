"""Correspondences, alignment, transfer and morphs between shapes that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.errors import Unsupported
from gensp.geometry.matching import aligning_rotation, matching, nearness_to_isometry
from gensp.geometry.mesh import Mesh
from gensp.geometry.morph import morphed
from gensp.geometry.rotation_registration import BANDLIMIT
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.geometry.transfer import transfer

TURN = Rotation.from_rotvec([0.9, -0.4, 1.7]).as_matrix()


def moved(map: SphericalMap) -> SphericalMap:
    """The same shape elsewhere, turned and larger, its sphere turned by `TURN`."""
    other = Rotation.from_rotvec([-0.2, 2.0, 0.5]).as_matrix()
    surface = 3 * map.surface @ other.T + np.array([5.0, -1, 2])
    return SphericalMap(map.sphere @ TURN.T, surface, map.faces, "moved")


def test_alignment_does_not_see_how_a_shape_lies(bumpy_map: SphericalMap) -> None:
    found = aligning_rotation(bumpy_map, moved(bumpy_map))
    assert Rotation.from_matrix(found @ TURN.T).magnitude() < 1e-4


def test_distances_align_maps_of_even_density(
    bumpy_map: SphericalMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing = np.zeros((BANDLIMIT, 2 * BANDLIMIT - 1), dtype=complex)
    monkeypatch.setattr("gensp.geometry.matching.density_signal", lambda *_: nothing)
    found = aligning_rotation(bumpy_map, moved(bumpy_map))
    assert Rotation.from_matrix(found @ TURN.T).magnitude() < 1e-3


def test_a_shape_matches_its_copy(bumpy_map: SphericalMap) -> None:
    copy = moved(bumpy_map)
    found = matching(bumpy_map, copy, TURN)
    np.testing.assert_allclose(found.positions, copy.surface, atol=1e-9)
    back = matching(copy, bumpy_map, TURN.T)
    np.testing.assert_allclose(back.positions, bumpy_map.surface, atol=1e-9)


def test_reliability_is_one_for_isometries_only(bumpy_map: SphericalMap) -> None:
    ball = icosphere(3)
    round_ = SphericalMap(ball.vertices, ball.vertices, ball.faces)
    np.testing.assert_allclose(matching(round_, round_).reliability, 1, atol=1e-9)
    found = matching(bumpy_map, round_).reliability
    assert found.min() > 0
    assert found.max() < 1
    np.testing.assert_allclose(found, nearness_to_isometry(bumpy_map, bumpy_map.sphere), rtol=1e-9)


def test_what_both_maps_stretch_alike_is_relied_on(bumpy_map: SphericalMap) -> None:
    assert nearness_to_isometry(bumpy_map, bumpy_map.sphere).min() < 0.9
    found = matching(bumpy_map, moved(bumpy_map), TURN).reliability
    np.testing.assert_allclose(found, 1, atol=1e-6)


def test_reliability_is_the_inverse_of_a_known_stretch(bumpy_map: SphericalMap) -> None:
    """A plate twice as long and half as wide has the same area and σ = 2 everywhere."""
    ball = icosphere(3)
    flat = SphericalMap(ball.vertices, ball.vertices * [1, 1, 1e-3], ball.faces)
    found = nearness_to_isometry(flat, flat.surface * [2, 0.5, 1])
    inner = np.abs(ball.vertices[:, 2]) > 0.5
    np.testing.assert_allclose(found[inner], 0.5, atol=1e-3)


def test_known_reliabilities_are_multiplied_in(
    bumpy_map: SphericalMap, rng: np.random.Generator
) -> None:
    own, other = rng.random((2, len(bumpy_map.sphere)))
    found = matching(bumpy_map, bumpy_map, weights=(own, other)).reliability
    np.testing.assert_allclose(found, own * other, atol=1e-6)


def test_positions_carry_themselves(bumpy_map: SphericalMap, ellipsoid: Mesh) -> None:
    finer = icosphere(4)
    target = SphericalMap(finer.vertices, finer.vertices, finer.faces)
    carried = transfer(bumpy_map.surface, bumpy_map, target)
    np.testing.assert_allclose(carried, bumpy_map.to_surface(finer.vertices), atol=1e-12)
    turned = target.rotated(TURN)
    again = transfer(bumpy_map.surface, bumpy_map, turned, TURN)
    np.testing.assert_allclose(again, carried, atol=1e-12)


def test_labels_are_not_blended(bumpy_map: SphericalMap) -> None:
    finer = icosphere(4)
    target = SphericalMap(finer.vertices, finer.vertices, finer.faces)
    labels = np.where(bumpy_map.sphere[:, 2] > 0, 7, -2)
    carried = transfer(labels, bumpy_map, target)
    assert set(np.unique(carried)) == {-2, 7}
    np.testing.assert_array_equal(carried[: len(labels)], labels)
    shades = (100 * labels).astype(np.uint8)[:, None]
    assert transfer(shades, bumpy_map, target).dtype == np.uint8


@pytest.mark.parametrize("values", [np.zeros(3), np.array(["a"] * 642), np.zeros((642, 2, 2))])
def test_what_does_not_fit_is_refused(bumpy_map: SphericalMap, values: np.ndarray) -> None:
    with pytest.raises(Unsupported, match="each of its 642 vertices is required"):
        transfer(values, bumpy_map, bumpy_map)


def test_morph_begins_and_ends_at_the_shapes(bumpy_map: SphericalMap) -> None:
    copy = moved(bumpy_map)
    frames = morphed(bumpy_map, copy, 5, level=3, rotation=TURN)
    np.testing.assert_allclose(frames[0].vertices, bumpy_map.surface, atol=1e-9)
    np.testing.assert_allclose(frames[-1].vertices, copy.surface, atol=1e-8)
    middle = (frames[0].vertices + frames[-1].vertices) / 2
    np.testing.assert_allclose(frames[2].vertices, middle, atol=1e-12)
