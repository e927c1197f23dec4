"""The outer surface of badly behaved meshes: turned, doubled, thin, hollow, loose, open."""

import numpy as np
import pytest
import trimesh

from gensp.errors import DegenerateMesh
from gensp.geometry.distance import closest_point, hausdorff
from gensp.geometry.mesh import Mesh, require_genus_zero, signed_volume
from gensp.geometry.solid import solid_surface
from gensp.geometry.sphere import icosphere

BALL = icosphere(3)
CELLS = 32
CELL = 2 / CELLS  # of a ball of radius one


def soup(*parts: Mesh) -> Mesh:
    """Triangles that share no vertices, as ShapeNet stores them."""
    corners = np.concatenate([part.vertices[part.faces].reshape(-1, 3) for part in parts])
    return Mesh(corners, np.arange(len(corners)).reshape(-1, 3), "soup")


def turned(mesh: Mesh, share: float) -> Mesh:
    """Some of the faces reversed, drawn at random."""
    drawn = np.random.default_rng(0).random(len(mesh.faces)) < share
    return Mesh(mesh.vertices, np.where(drawn[:, None], mesh.faces[:, ::-1], mesh.faces))


def moved(mesh: Mesh, scale: float = 1.0, along: tuple = (0.0, 0.0, 0.0)) -> Mesh:
    return Mesh(scale * mesh.vertices + np.array(along), mesh.faces)


def doubled(mesh: Mesh) -> Mesh:
    """Every face also reversed."""
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:, ::-1]]))


def boxed(*sides: float, at: tuple = (0.0, 0.0, 0.0)) -> Mesh:
    box = trimesh.creation.box(sides)
    return Mesh(np.array(box.vertices) + np.array(at), np.array(box.faces))


def of(mesh: Mesh, **words: float) -> Mesh:
    found = solid_surface(mesh, resolution=CELLS, vertices=1000, largest_radius=0.0, **words).mesh
    require_genus_zero(found)
    return found


BALLS = {
    "as it should be": soup(BALL),
    "a tenth turned": soup(turned(BALL, 0.1)),
    "half turned": soup(turned(BALL, 0.5)),
    "inside out": soup(turned(BALL, 1.0)),
    "every face also reversed": soup(doubled(BALL)),
    "a ball within": soup(BALL, moved(BALL, 0.5)),
    "a ball within, inside out": soup(BALL, turned(moved(BALL, 0.5), 1.0)),
    "a hollow of half its size": soup(BALL, moved(turned(BALL, 0.5), 0.5)),
}


@pytest.mark.parametrize("case", BALLS)
def test_a_ball_stays_a_ball_however_it_is_stored(case: str) -> None:
    found = of(BALLS[case])
    assert hausdorff(found, BALL) < 0.3 * CELL
    assert signed_volume(found) == pytest.approx(signed_volume(BALL), rel=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_union_of_two_balls_does_not_depend_on_their_faces(share: float) -> None:
    second = moved(BALL, along=(1.2, 0.0, 0.0))
    found = of(soup(BALL, turned(second, share)))
    cap = np.pi * 0.4**2 * (3 - 0.4) / 3
    assert signed_volume(found) == pytest.approx(8 / 3 * np.pi - 2 * cap, rel=0.03)


SLAB = boxed(1.0, 1.0, 0.5 / CELLS)
SHEET = Mesh(
    np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)


@pytest.mark.parametrize("top", [SLAB, SHEET, doubled(SHEET)], ids=["slab", "sheet", "two sheets"])
def test_a_table_keeps_a_top_thinner_than_a_cell(top: Mesh) -> None:
    leg = boxed(0.15, 0.15, 0.7, at=(0.0, 0.0, -0.35))
    found = of(soup(top, leg))
    assert np.ptp(found.vertices, axis=0) == pytest.approx([1.0, 1.0, 0.7], abs=2 / CELLS)
    assert closest_point(top.vertices, found).distance.max() < 1.2 / CELLS


def test_a_corked_bottle_with_a_thin_wall_is_full() -> None:
    """Wall, liquid and cork: three closed parts, the wall thinner than a cell."""
    wall = 0.5 * CELL
    profile = [(0, -1), (0.6, -1), (0.6, 0.4), (0.25, 0.7), (0.25, 1)]
    inner = [(0.25 - wall, 1), (0.25 - wall, 0.7), (0.6 - wall, 0.4), (0.6 - wall, wall - 1)]
    shell = trimesh.creation.revolve([*profile, *inner, (0, wall - 1)], sections=32)
    cork = trimesh.creation.cylinder(0.25 - wall / 4, 0.3, sections=32)
    liquid = trimesh.creation.cylinder(0.45, 1.0, sections=32)
    places = ((shell, 0.0), (cork, 0.95), (liquid, -0.4))
    parts = [
        moved(Mesh(np.array(m.vertices), np.array(m.faces)), along=(0, 0, z)) for m, z in places
    ]
    found = of(soup(*parts))
    full = trimesh.creation.revolve([*profile, (0, 1)], sections=32)
    assert signed_volume(found) == pytest.approx(abs(full.volume), rel=0.06)


def test_what_is_lost_is_told() -> None:
    """A ball beside another that it does not touch: only one is kept."""
    apart = soup(BALL, moved(BALL, 0.6, (2.5, 0.0, 0.0)))
    with pytest.raises(DegenerateMesh, match=r"seen from outside lie 0\.\d+ diagonals .* 0\.03"):
        of(apart)
    assert hausdorff(of(apart, largest_distance=1.0), BALL) < CELL
    inside = soup(BALL, moved(BALL, 0.3))
    assert hausdorff(of(inside), BALL) < 0.3 * CELL
