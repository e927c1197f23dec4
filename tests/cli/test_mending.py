"""Diagnosis and repair of known defects."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_bad_meshes import DEFECTS

from gensp.errors import BadMesh, NotGenusZero
from gensp.geometry.diagnosis import Diagnosis, diagnose
from gensp.geometry.distance import hausdorff
from gensp.geometry.mesh import Mesh, load_mesh, require_genus_zero
from gensp.geometry.repair import repair
from gensp.geometry.solid import solid_surface
from gensp.geometry.sphere import icosphere

BALL = icosphere(2)
UNREADABLE = ("empty", "no_triangles", "garbage", "truncated")
READABLE = [name for name in DEFECTS if name not in (*UNREADABLE, "huge")]
COUNTS = {
    "open": {"boundary_edges": 3, "holes": 1, "genus": 0},
    "non_manifold": {"nonmanifold_edges": 1, "boundary_edges": 2},
    "pinched": {"nonmanifold_vertices": 1},
    "flipped": {"misoriented_edges": 3},
    "inside_out": {"inward": True, "genus": 0},
    "two_parts": {"components": 2},
    "genus_one": {"genus": 1, "components": 1},
    "nan": {"not_finite": 1},
    "stray_vertex": {"unused_vertices": 1},
    "one_triangle": {"boundary_edges": 3, "holes": 1},
}
MENDED = [
    "open",
    "non_manifold",
    "pinched",
    "flipped",
    "inside_out",
    "two_parts",
    "nan",
    "zero_area",
    "stray_vertex",
]


@pytest.fixture
def defect(tmp_path: Path) -> Callable[[str], Mesh]:
    def make(name: str) -> Mesh:
        path = tmp_path / f"{name}.ply"
        DEFECTS[name][0](path)
        return load_mesh(path)

    return make


@pytest.mark.parametrize("name", READABLE)
def test_verdict_is_that_of_the_check(defect: Callable[[str], Mesh], name: str) -> None:
    found = diagnose(defect(name))
    assert not found.usable
    assert found.findings
    assert all(remedy for _, remedy in found.findings)


@pytest.mark.parametrize("name", COUNTS)
def test_counts(defect: Callable[[str], Mesh], name: str) -> None:
    found = diagnose(defect(name))
    assert {key: getattr(found, key) for key in COUNTS[name]} == COUNTS[name]


def test_sound_mesh_has_no_finding(bumpy: Mesh) -> None:
    found = diagnose(bumpy)
    assert found == Diagnosis("bumpy", 642, 1280, components=1, genus=0)
    assert found.usable
    assert found.findings == []


def test_too_many_faces_are_a_finding(bumpy: Mesh) -> None:
    found = diagnose(bumpy, max_faces=1000)
    told = "1280 faces (at most 1000 are taken)"
    assert found.findings == [(told, "gensp repair --remesh")]


@pytest.mark.parametrize("name", MENDED)
def test_mended_mesh_passes_the_check(defect: Callable[[str], Mesh], name: str) -> None:
    broken = defect(name)
    result = repair(broken)
    require_genus_zero(result.mesh)
    assert result.steps
    finite = Mesh(np.nan_to_num(broken.vertices), broken.faces)
    kept = np.isin(result.mesh.vertices, finite.vertices).all(axis=1)
    assert kept.mean() > 0.95


def test_sound_mesh_stays_as_it_is(bumpy: Mesh) -> None:
    result = repair(bumpy)
    assert result.steps == {}
    np.testing.assert_array_equal(result.mesh.vertices, bumpy.vertices)
    np.testing.assert_array_equal(result.mesh.faces, bumpy.faces)


def test_soup_is_welded_back(bumpy: Mesh) -> None:
    corners = np.arange(3 * len(bumpy.faces)).reshape(-1, 3)
    soup = Mesh(bumpy.vertices[bumpy.faces].reshape(-1, 3), corners)
    result = repair(soup).mesh
    require_genus_zero(result)
    assert len(result.vertices) == len(bumpy.vertices)
    assert hausdorff(result, bumpy) == 0


def test_rounded_soup_is_welded_back(bumpy: Mesh, rng: np.random.Generator) -> None:
    corners = np.arange(3 * len(bumpy.faces)).reshape(-1, 3)
    noise = 1e-9 * rng.standard_normal((corners.size, 3))
    soup = Mesh(bumpy.vertices[bumpy.faces].reshape(-1, 3) + noise, corners)
    result = repair(soup, weld=1e-6).mesh
    require_genus_zero(result)
    assert len(result.vertices) == len(bumpy.vertices)


def test_many_flipped_faces_are_turned_back(bumpy: Mesh, rng: np.random.Generator) -> None:
    flipped = rng.random(len(bumpy.faces)) < 0.3
    faces = np.where(flipped[:, None], bumpy.faces[:, ::-1], bumpy.faces)
    result = repair(Mesh(bumpy.vertices, faces))
    np.testing.assert_array_equal(result.mesh.faces, bumpy.faces)
    assert result.steps == {"faces turned": int(flipped.sum())}


def test_repeated_faces_and_flaps(bumpy: Mesh) -> None:
    apex = np.concatenate([bumpy.vertices, [[3.0, 0, 0]]])
    a, b, _ = bumpy.faces[0]
    flap = np.array([[a, b, 642], [b, a, 642]])
    copies = np.concatenate([bumpy.faces[:20], bumpy.faces[5:9, ::-1]])
    result = repair(Mesh(apex, np.concatenate([bumpy.faces, flap, copies]))).mesh
    require_genus_zero(result)
    assert len(result.faces) == len(bumpy.faces)
    assert hausdorff(result, bumpy) == 0


def test_cap_and_needle_lose_their_flatness(bumpy: Mesh) -> None:
    # A vertex on an edge makes a cap: the edge's own triangle is still whole.
    a, b, c = bumpy.faces[0]
    vertices = np.concatenate([bumpy.vertices, [(bumpy.vertices[a] + bumpy.vertices[b]) / 2]])
    split = np.array([[a, 642, c], [642, b, c], [a, b, 642]])
    cap = Mesh(vertices, np.concatenate([bumpy.faces[1:], split]))
    require_genus_zero(repair(cap).mesh)
    assert hausdorff(repair(cap).mesh, bumpy) < 0.02
    vertices = bumpy.vertices.copy()
    vertices[a] = vertices[b]
    needle = repair(Mesh(vertices, bumpy.faces)).mesh
    require_genus_zero(needle)
    assert len(needle.vertices) == len(bumpy.vertices) - 1


def test_large_holes_stay_open(bumpy: Mesh) -> None:
    half = Mesh(bumpy.vertices, bumpy.faces[bumpy.vertices[bumpy.faces, 2].mean(axis=1) < 0])
    assert diagnose(repair(half, largest_hole=0.5).mesh).holes == 1
    closed = repair(half, largest_hole=3.0).mesh
    require_genus_zero(closed)


def _with_second(vertices: np.ndarray) -> Mesh:
    """A ball, and another one in the same mesh."""
    faces = np.concatenate([BALL.faces, BALL.faces + len(vertices)])
    return Mesh(np.concatenate([BALL.vertices, vertices]), faces)


def test_dropped_parts_are_told_by_their_area() -> None:
    """A ball with half the radius has a fourth of the area."""
    found = repair(_with_second(BALL.vertices / 2 + 3))
    assert found.steps["parts dropped"] == 1
    assert found.dropped == pytest.approx(0.2)


def test_nothing_left_is_told() -> None:
    with pytest.raises(BadMesh, match="no triangle with an area is left"):
        repair(Mesh(np.full((4, 3), np.nan), np.array([[0, 1, 2], [1, 2, 3]])))


def test_parts_that_overlap_become_one() -> None:
    solid = solid_surface(
        _with_second(BALL.vertices + np.array([1.2, 0, 0])), resolution=40, vertices=1500
    )
    require_genus_zero(solid.mesh)
    assert solid.radius == 0
    # Two caps of height 0.4 of unit balls are shared.
    cap = np.pi * 0.4**2 * (3 - 0.4) / 3
    assert _volume(solid.mesh) == pytest.approx(8 / 3 * np.pi - 2 * cap, rel=0.05)


def test_handles_are_closed() -> None:
    ring = trimesh.creation.torus(major_radius=1.0, minor_radius=0.8, major_sections=48)
    torus = Mesh(np.array(ring.vertices), np.array(ring.faces, dtype=np.int64), "torus")
    assert diagnose(torus).genus == 1
    solid = solid_surface(torus, resolution=32, vertices=1000)
    require_genus_zero(solid.mesh)
    assert solid.radius > 0
    # Nothing moves but what fills the hole of radius 0.2, at most as deep as the ring is thick.
    assert hausdorff(solid.mesh, torus) < 0.3
    volume = 2 * np.pi**2 * 0.8**2
    assert volume < _volume(solid.mesh) * 1.02
    assert _volume(solid.mesh) < volume * 1.1


def test_handles_that_stay_are_told(
    defect: Callable[[str], Mesh], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gensp.geometry.solid.RADII", (0.0, 0.01))
    with pytest.raises(NotGenusZero, match=r"genus 1 is left .* radius of 0\.01 diagonals"):
        solid_surface(defect("genus_one"), resolution=24, vertices=600)


def test_open_shell_is_closed_across_its_hole(bumpy: Mesh) -> None:
    top = bumpy.vertices[bumpy.faces, 2].min(axis=1) > 0.8
    solid = solid_surface(Mesh(bumpy.vertices, bumpy.faces[~top]), resolution=40, vertices=2000)
    require_genus_zero(solid.mesh)
    assert _volume(solid.mesh) == pytest.approx(_volume(bumpy), rel=0.1)


def _volume(mesh: Mesh) -> float:
    return float(np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6)
