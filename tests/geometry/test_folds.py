from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.data.blobs import BlobFamily, blob_samples
from gensp.geometry.flow import cmcf
from gensp.geometry.folds import folded_faces
from gensp.geometry.mesh import Mesh, load_mesh, normalize, simplify
from gensp.geometry.predicates import bad_faces
from gensp.geometry.remesh import sound_mesh
from gensp.geometry.sphere import icosphere, unit

HEADS = Path(__file__).parents[2] / "data" / "heads" / "meshes"


def flipped(mesh: Mesh, face: int) -> Mesh:
    """A corner of a face moved across the opposite side, by a seventh of the height."""
    apex, a, b = mesh.faces[face]
    vertices = mesh.vertices.copy()
    vertices[apex] += 1.15 * (0.5 * (vertices[a] + vertices[b]) - vertices[apex])
    return mesh.with_vertices(vertices)


def swapped(mesh: Mesh, face: int) -> Mesh:
    """Two neighbours that have changed places."""
    a, b = mesh.faces[face, :2]
    vertices = mesh.vertices.copy()
    vertices[[a, b]] = vertices[[b, a]]
    return mesh.with_vertices(vertices)


@pytest.mark.parametrize("damage", [flipped, swapped])
@pytest.mark.parametrize("shape", ["bumpy", "ellipsoid", "dumbbell"])
def test_a_turned_triangle_is_found(damage, shape, request, rng):
    mesh = request.getfixturevalue(shape)
    assert not folded_faces(mesh).any()
    for face in rng.choice(len(mesh.faces), 20, replace=False):
        found = folded_faces(damage(mesh, face))
        assert found[face]
        # Only what touches the moved vertices can be at fault.
        assert found.sum() <= 10


@pytest.mark.parametrize("name", ["id000_neutral", "id005_neutral", "id014_neutral"])
@pytest.mark.parametrize("vertices", [2500, 10_000])
def test_heads_have_no_folds(name, vertices):
    assert not folded_faces(simplify(load_mesh(HEADS / f"{name}.ply"), vertices)).any()


def test_blobs_have_no_folds():
    for mesh, _ in blob_samples(BlobFamily(count=3)):
        assert not folded_faces(mesh).any()


def test_sharp_rims_are_no_folds():
    # A lens of a few degrees at its rim, and one with a fin as thin.
    ball = icosphere(4)
    assert not folded_faces(Mesh(ball.vertices * np.array([1, 1, 0.02]), ball.faces)).any()
    x, y, z = ball.vertices.T
    fin = np.where(np.abs(y) < 0.12, np.maximum(z, 0) ** 2, 0)
    assert not folded_faces(Mesh(np.stack([x, y, z + fin], axis=1), ball.faces)).any()


def test_folds_do_not_depend_on_position_scale_and_rotation(bumpy):
    mesh = swapped(flipped(bumpy, 100), 900)
    turn = Rotation.from_rotvec([0.3, 1.0, -0.7]).as_matrix()
    moved = mesh.with_vertices(5 * mesh.vertices @ turn.T + 3)
    np.testing.assert_array_equal(folded_faces(moved), folded_faces(mesh))


def test_folds_near_the_sphere_are_those_of_the_map(rng):
    ball = icosphere(4)
    moved = ball.vertices + 0.1 * rng.standard_normal(ball.vertices.shape)
    shape = normalize(ball.with_vertices(unit(moved)))
    bad = bad_faces(unit(shape.vertices), shape.faces)
    assert bad.any()
    assert (folded_faces(shape) >= bad).all()


def test_faces_without_area_are_folds(bumpy):
    vertices = bumpy.vertices.copy()
    vertices[bumpy.faces[7]] = vertices[bumpy.faces[7, 0]]
    assert folded_faces(bumpy.with_vertices(vertices))[7]


@pytest.mark.parametrize("damage", [flipped, swapped])
def test_a_folded_shape_is_never_passed_on_with_its_own_triangles(damage, bumpy):
    # Angles and areas are sound: the fold alone makes it unusable.
    mesh, remeshed = sound_mesh(damage(bumpy, 300), 642, smallest_angle=0.1)
    assert remeshed
    assert not folded_faces(mesh).any()


def test_a_flow_with_a_fold_is_unsound(bumpy):
    assert cmcf(bumpy).sound.all()
    # What was turned over at the start stays so for some steps.
    flow = cmcf(swapped(bumpy, 300), max_steps=3)
    folded = [folded_faces(Mesh(vertices, flow.faces)).any() for vertices in flow.vertices]
    assert folded[1]
    np.testing.assert_array_equal(flow.sound[1:], ~np.array(folded[1:]))


def test_creases_of_an_input_are_its_own(bumpy):
    """What is damage on the way to the sphere is kept where it is the scan's."""
    creased = swapped(bumpy, 300)
    mesh, remeshed = sound_mesh(creased, 642, smallest_angle=0.1, unfolded=False)
    assert not remeshed
    np.testing.assert_array_equal(mesh.vertices, creased.vertices)
