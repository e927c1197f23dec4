"""Pictures that compare: what is painted is the error that the maps have."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.pictures.comparing import PLAIN, WORST, WRONG, Matched, error_colours, textured_rows
from gensp.pictures.render import Scene, look

SIZE = 48
ENDS = {"plain": np.array(PLAIN), "wrong": np.array(WRONG)}


def vertices(mesh: Mesh, count: int) -> SurfacePoints:
    """Its first corners, in the order of the faces."""
    return SurfacePoints(np.arange(count), np.tile([1.0, 0, 0], (count, 1)))


@pytest.fixture
def pair(ellipsoid: Mesh) -> dict[str, SphericalMap]:
    """Twice the same shape, the second turned on the sphere by a right angle."""
    sphere = icosphere(3).vertices
    still = SphericalMap(sphere, ellipsoid.vertices, ellipsoid.faces, "still")
    turn = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    return {"still": still, "turned": replace(still.rotated(turn), name="turned")}


def matched(truth: Callable) -> Matched:
    return Matched(truth, look(), SIZE)


def test_colours_of_errors_end_at_the_worst() -> None:
    colours = error_colours(np.array([0.0, WORST, 9.0]))
    np.testing.assert_allclose(colours[0], PLAIN, atol=1e-6)
    np.testing.assert_allclose(colours[1:], [WRONG, WRONG], atol=1e-6)


def test_maps_that_agree_carry_the_very_colours(pair: dict[str, SphericalMap]) -> None:
    same = {"still": pair["still"], "again": replace(pair["still"], name="again")}
    at = vertices(pair["still"].mesh, 1280)
    above, below = matched(lambda a, b: (at, at, True)).rows(same, "toy")
    np.testing.assert_allclose(above[0].image.astype(int), above[1].image, atol=1)
    assert below[1].note == "mean error 0.000"
    plain = scene(pair["still"]).by_vertex(np.tile(ENDS["plain"], (642, 1)))
    np.testing.assert_allclose(below[1].image.astype(int), plain, atol=1)


def test_a_turned_map_is_painted_wrong(pair: dict[str, SphericalMap]) -> None:
    at = vertices(pair["still"].mesh, 1280)
    _, below = matched(lambda a, b: (at, at, True)).rows(pair, "toy")
    red = scene(pair["still"]).by_vertex(np.tile(ENDS["wrong"], (642, 1)))
    # Far from the axis a right angle is more than the worst that has a colour of its own.
    alike = (np.abs(below[1].image.astype(int) - red).max(axis=2) < 3) & (red < 255).any(axis=2)
    assert alike.sum() > 0.5 * (red < 255).any(axis=2).sum()


def test_keypoints_are_dots_where_they_are(pair: dict[str, SphericalMap]) -> None:
    mesh = pair["still"].mesh
    front = int(np.argmax(mesh.vertices @ look().rotation[2]))
    face, corner = np.argwhere(mesh.faces == front)[0]
    at = SurfacePoints(np.array([face]), np.eye(3)[[corner]])
    known, unknown = matched(lambda a, b: (at, at, False)), matched(lambda a, b: None)
    dotted, grey = known.rows(pair, "toy")[1][1], unknown.rows(pair, "toy")[1][1]
    assert dotted.note.startswith("at 1 keypoints")
    assert grey.note == "no ground truth"
    rows, columns = np.nonzero((dotted.image != grey.image).any(axis=2))
    middle = look().fitted(mesh.vertices).project(mesh.vertices[[front]])[0]
    expected = (SIZE / 2 * (1 - middle[1]), SIZE / 2 * (1 + middle[0]))
    np.testing.assert_allclose((rows.mean() + 0.5, columns.mean() + 0.5), expected, atol=1)
    assert 0 < len(rows) < 0.05 * SIZE**2


def test_every_method_has_a_row(pair: dict[str, SphericalMap]) -> None:
    rows = textured_rows({"a": pair, "b": pair}, look(), SIZE)
    assert [[tile.caption for tile in row] for row in rows] == [
        ["a", "still", "turned"],
        ["b", "still", "turned"],
    ]
    for one, other in zip(*rows, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
    assert (rows[0][1].image != rows[0][2].image).any()


def scene(map: SphericalMap) -> Scene:
    return Scene(map.mesh, look().fitted(map.surface), SIZE, closed=True)
