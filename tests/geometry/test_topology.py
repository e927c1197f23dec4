"""Closed genus-0 surfaces by indices: every way to be none is told, and by what it is."""

import numpy as np
import pytest

from gensp.geometry.sphere import icosphere
from gensp.geometry.topology import half_edges, opposite_sides, sphere_fault

BALL = icosphere(2)
FACES, COUNT = BALL.faces, len(BALL.vertices)


def torus(n: int) -> np.ndarray:
    """Triangles of an n × n grid that closes in both directions."""
    i, j = np.divmod(np.arange(n * n), n)
    right, up = n * ((i + 1) % n), (j + 1) % n
    a, b, c, d = n * i + j, right + j, right + up, n * i + up
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def pinched() -> np.ndarray:
    """Two spheres with vertex 0 in common."""
    return np.concatenate([FACES, np.where(FACES == 0, 0, FACES + COUNT - 1)])


def turned(faces: np.ndarray, face: int) -> np.ndarray:
    changed = faces.copy()
    changed[face] = changed[face, ::-1]
    return changed


BROKEN = {
    "missing": (FACES[1:], COUNT, "3 boundary edges"),
    "repeated": (np.concatenate([FACES, FACES[:1]]), COUNT, "3 edges with more than two faces"),
    "island": (np.concatenate([FACES, FACES + COUNT]), 2 * COUNT, "2 connected components"),
    "unused": (FACES, COUNT + 1, "1 vertices belong to no face"),
    "pinched": (pinched(), 2 * COUNT - 1, "a vertex joins several sheets"),
    "turned": (turned(FACES, 4), COUNT, "neighbouring faces disagree in orientation"),
    "torus": (torus(5), 25, r"Euler characteristic 0 (genus 1)"),
    "outside": (np.where(FACES == 3, COUNT, FACES), COUNT, "faces name vertices outside the 162"),
    "negative": (FACES - 1, COUNT, "faces name vertices outside the 162"),
    "flat": (
        np.concatenate([FACES, FACES[:1, [0, 0, 1]]]),
        COUNT,
        "edges with more than two faces",
    ),
    "none": (FACES[:0], COUNT, "there are no faces"),
    # A face of two corners is its own neighbour on all sides.
    "alone": (np.array([[0, 0, 1]]), 2, "1 boundary edges"),
}


def test_a_sphere_has_no_fault(rng):
    assert sphere_fault(FACES, COUNT) is None
    order = rng.permutation(COUNT)
    shift = rng.integers(3, size=(len(FACES), 1))
    rolled = np.take_along_axis(FACES, (np.arange(3) + shift) % 3, axis=1)
    assert sphere_fault(rng.permutation(order[rolled]), COUNT) is None
    assert sphere_fault(FACES[:, ::-1], COUNT) is None


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_sphere_is_told(name):
    faces, count, told = BROKEN[name]
    fault = sphere_fault(faces, count)
    assert fault is not None
    assert told in fault.found


def test_opposite_sides_run_back():
    sides, opposite = half_edges(FACES), opposite_sides(FACES, COUNT)
    np.testing.assert_array_equal(sides[opposite], sides[:, ::-1])
    np.testing.assert_array_equal(opposite[opposite], np.arange(len(sides)))
