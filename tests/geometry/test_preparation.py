"""Preparing a mesh: only what is asked for is done, and the surface stays where it was."""

import numpy as np
import pytest
from layouts import ring

from gensp.errors import DegenerateMesh, NotGenusZero, Unsupported
from gensp.geometry.distance import hausdorff
from gensp.geometry.mesh import Mesh, require_genus_zero
from gensp.geometry.preparation import Preparation
from gensp.geometry.repair import STEPS, repair
from gensp.geometry.retriangulation import retriangulate
from gensp.geometry.solid import solid_surface


@pytest.fixture
def torn(bumpy: Mesh) -> Mesh:
    """A hole, a face turned over, and a ball beside it."""
    faces = bumpy.faces[1:].copy()
    faces[100] = faces[100, ::-1]
    vertices = np.concatenate([bumpy.vertices, 0.2 * bumpy.vertices + 3])
    beside = bumpy.faces + len(bumpy.vertices)
    return Mesh(vertices, np.concatenate([faces, beside]), "torn")


def test_a_sound_mesh_is_left_alone(bumpy: Mesh, rng: np.random.Generator) -> None:
    found = Preparation(repair=STEPS)(bumpy, rng)
    assert (found.verdict, found.done, found.hausdorff) == ("usable", (), 0.0)
    assert found.mesh is bumpy


def test_only_what_is_asked_for_is_mended(torn: Mesh, rng: np.random.Generator) -> None:
    nothing = Preparation()(torn, rng)
    assert nothing.verdict == "dropped"
    assert "3 boundary edges in 1 hole" in nothing.reason
    assert nothing.remedy == "recipe.prepare.repair: add orient, components, holes"
    some = Preparation(repair=("holes",))(torn, rng)
    assert some.verdict == "dropped"
    assert "hole" not in some.reason
    assert some.remedy == "recipe.prepare.repair: add orient, components"


def test_what_is_needed_mends(torn: Mesh, bumpy: Mesh, rng: np.random.Generator) -> None:
    found = Preparation(repair=("orient", "components", "holes"))(torn, rng)
    assert found.verdict == "repaired"
    assert found.mesh is not None
    require_genus_zero(found.mesh)
    assert hausdorff(found.mesh, bumpy) < 1e-9
    assert found.done == ("1 face turned", "1 part dropped", "1 hole filled")
    assert found.hausdorff is not None
    assert found.hausdorff > 0.1  # the part that was dropped lies far off


def test_unknown_mending_lists_the_known_kinds() -> None:
    with pytest.raises(Unsupported, match=r"'heal' is no kind of mending; .* holes, solid"):
        Preparation(repair=("heal",))


def test_impossible_corners_need_their_own_step(bumpy: Mesh) -> None:
    broken = Mesh(bumpy.vertices, np.concatenate([bumpy.faces, [[0, 1, 9999]]]))
    with pytest.raises(DegenerateMesh, match=r"1 faces have corners .* add 'finite'"):
        repair(broken, steps=("merge",))
    require_genus_zero(repair(broken, steps=("finite",)).mesh)


def test_the_steps_do_not_depend_on_the_order_of_their_names(torn: Mesh) -> None:
    forward = repair(torn, steps=STEPS)
    backward = repair(torn, steps=STEPS[::-1])
    assert forward.steps == backward.steps
    assert np.array_equal(forward.mesh.vertices, backward.mesh.vertices)


def test_larger_meshes_are_simplified_or_dropped(bumpy: Mesh, rng: np.random.Generator) -> None:
    found = Preparation(vertices=200)(bumpy, rng)
    assert found.mesh is not None
    assert abs(len(found.mesh.vertices) - 200) <= 2
    assert found.hausdorff is not None
    assert 0 < found.hausdorff < 0.05
    assert found.done == (f"simplified, 642 → {len(found.mesh.vertices)} vertices",)
    large = Preparation(max_faces=500)(bumpy, rng)
    assert large.reason == "1280 faces; at most 500 are taken"


def test_own_triangles_stay_on_the_surface(bumpy: Mesh, rng: np.random.Generator) -> None:
    other = retriangulate(bumpy, 500, rng)
    require_genus_zero(other)
    assert abs(len(other.vertices) - 500) <= 2
    diagonal = np.linalg.norm(np.ptp(bumpy.vertices, axis=0))
    assert hausdorff(other, bumpy) < 0.02 * diagonal


def test_own_triangles_share_neither_order_nor_vertices(bumpy: Mesh) -> None:
    first, second = (retriangulate(bumpy, 500, np.random.default_rng(k)) for k in (0, 1))
    again = retriangulate(bumpy, 500, np.random.default_rng(0))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    places = [{tuple(row) for row in np.round(mesh.vertices, 6)} for mesh in (first, second)]
    assert len(places[0] & places[1]) < 0.2 * 500
    faces = [{tuple(sorted(face)) for face in mesh.faces.tolist()} for mesh in (first, second)]
    assert len(faces[0] & faces[1]) < 0.02 * len(first.faces)


def test_a_radius_of_zero_refuses_handles() -> None:
    with pytest.raises(NotGenusZero, match=r"genus 1 is left .* up to a radius of 0 diagonals"):
        solid_surface(ring(), resolution=32, vertices=500, largest_radius=0.0)
