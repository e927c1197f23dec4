"""Edges of a grid through triangles, and what a flood from outside finds."""

import numpy as np
import trimesh

from gensp.compiled.crossings import crossed_edges
from gensp.geometry.enclosure import INSIDE, UNKNOWN, enclosure
from gensp.geometry.isosurface import Grid
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere

SQUARE = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)


def test_edges_cross_a_square_where_they_should() -> None:
    """A square of 2.8 cells at height 1.5: the edges of the four nodes below it, upwards."""
    corners = 2.8 * SQUARE + [0.1, 0.1, 1.5]
    crossed = crossed_edges(corners, (4, 4, 4))
    expected = np.zeros((3, 4, 4, 4), dtype=bool)
    expected[2, 1:3, 1:3, 1] = True
    assert np.array_equal(crossed, expected)
    turned = crossed_edges(np.roll(corners, 1, axis=2), (4, 4, 4))
    assert np.array_equal(turned[0], np.moveaxis(expected[2], 2, 0))


def test_no_edge_slips_through_a_seam() -> None:
    """The diagonal of the square runs through nodes."""
    crossed = crossed_edges(3.0 * SQUARE + [0.0, 0.0, 1.5], (4, 4, 4))
    assert crossed[2, :, :, 1].all()


def test_a_node_on_a_triangle_is_cut_off_from_both_sides() -> None:
    crossed = crossed_edges(3.0 * SQUARE + [0.0, 0.0, 2.0], (4, 4, 4))
    assert crossed[2, :, :, 1:3].all()
    assert not crossed[2, :, :, 0].any()


def test_winding_numbers_decide_where_they_tell_what_the_flood_tells() -> None:
    ball = icosphere(2)
    grid = Grid.over(np.array([[-1.3] * 3, [1.3] * 3]), 16)
    assert (enclosure(ball, grid).side == UNKNOWN).all()
    can = [(0, -1), (1, -1), (1, 1), (0.3, 1), (0.3, 0.8), (0.8, 0.8), (0.8, -0.8), (0, -0.8)]
    plug = trimesh.creation.box((0.8, 0.8, 0.1)).apply_translation((0, 0, 1.05))
    plugged = trimesh.util.concatenate([trimesh.creation.revolve(can, sections=24), plug])
    hollow = enclosure(Mesh(np.array(plugged.vertices), np.array(plugged.faces)), grid)
    nodes = grid.points(np.indices(hollow.side.shape).reshape(3, -1).T)
    radius, height = np.linalg.norm(nodes[:, :2], axis=1), np.abs(nodes[:, 2])
    inner, outer = (radius < 0.95) & (height < 0.95), (radius > 1.0) | (height > 1.15)
    assert (hollow.side.reshape(-1)[inner] == INSIDE).all()
    assert (hollow.field(nodes, np.inf)[inner] < 0).all()
    assert (hollow.field(nodes, np.inf)[outer] > 0).all()
    assert np.abs(hollow.seen).max(axis=1).min() > 0.7
