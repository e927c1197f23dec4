import pickle

import numpy as np
import pytest
import trimesh

from gensp.errors import NotEmbeddable
from gensp.geometry.alignment import centre_of_area
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import icosphere, tangent_frame, unit
from gensp.methods.cmcf import CMCF
from gensp.methods.refinement import (
    HIERARCHICAL,
    PREDICTION,
    CertifiedRefinement,
    NewtonRefinement,
    NoRefinement,
)


def _folded(sphere, faces, rng, share=0.05):
    folded = sphere.copy()
    moved = rng.choice(len(sphere), int(share * len(sphere)), replace=False)
    frames = tangent_frame(sphere[moved])
    folded[moved] += 0.3 * np.einsum("nik,nk->ni", frames, rng.standard_normal((len(moved), 2)))
    assert bad_faces(unit(folded), faces).any()
    return unit(folded)


def test_sphere_stays_a_sphere():
    ball = icosphere(3)
    map = CMCF(NewtonRefinement())(ball)
    assert map.distortion().max < 1.05
    assert map.diagnostics["bad_faces"] == 0


def test_map_keeps_the_inputs_coordinates_and_order(bumpy):
    moved = bumpy.with_vertices(7 * bumpy.vertices + 100)
    map = CMCF(NewtonRefinement())(moved)
    np.testing.assert_array_equal(map.surface, moved.vertices)
    np.testing.assert_array_equal(map.faces, moved.faces)
    np.testing.assert_allclose(np.linalg.norm(map.sphere, axis=1), 1)


def test_refined_flow_of_a_limbed_shape_has_no_fold_and_little_distortion(limbed):
    raw, refined = (CMCF(refine)(limbed) for refine in (NoRefinement(), NewtonRefinement()))
    assert not refined.bad_faces().any()
    assert refined.degree() == 1
    assert refined.distortion().max < 0.1 * raw.distortion().max
    assert refined.diagnostics["flow_steps"] > 5


@pytest.mark.parametrize("shape", ["bumpy", "limbed"])
def test_refined_map_is_centred_and_says_so(shape, request):
    mesh = request.getfixturevalue(shape)
    map = CMCF(NewtonRefinement())(mesh)
    centre = centre_of_area(map.sphere, mesh.faces, mesh.face_areas)
    assert np.linalg.norm(centre) < 1e-8
    assert map.diagnostics["centred"] is True
    assert map.certify().bijective


def test_folded_map_is_left_where_it_is_and_said_to_be_off_centre(bumpy, rng):
    folded = _folded(unit(bumpy.vertices + np.array([0.3, 0, 0])), bumpy.faces, rng)
    map = CMCF(lambda mesh, *_: NoRefinement()(mesh, folded))(bumpy)
    np.testing.assert_array_equal(map.sphere, unit(folded))
    assert map.diagnostics["centred"] is False


def test_map_is_invariant_under_similarities_up_to_rotation(bumpy, rng):
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    map = CMCF(NewtonRefinement())(bumpy)
    moved = CMCF(NewtonRefinement())(bumpy.with_vertices(3 * bumpy.vertices @ rotation.T - 1))
    np.testing.assert_allclose(moved.sphere, map.sphere @ rotation.T, atol=1e-5)


def test_unrefined_map_counts_its_folds(bumpy, rng):
    folded = _folded(unit(bumpy.vertices), bumpy.faces, rng)
    map = NoRefinement()(bumpy, folded)
    np.testing.assert_allclose(map.sphere, folded, atol=1e-15)
    assert map.diagnostics["bad_faces"] == bad_faces(folded, bumpy.faces).sum() > 0
    assert "rung" not in map.diagnostics, "nothing was climbed"


def test_folded_prediction_is_untangled_and_stays_near(bumpy, rng):
    target = unit(bumpy.vertices)
    folded = _folded(target, bumpy.faces, rng)
    map = NewtonRefinement(pull=100.0)(bumpy, folded, target)
    assert map.diagnostics["rung"] == "untangled"
    assert map.diagnostics["bad_faces_start"] > 0
    assert map.diagnostics["bad_faces"] == 0
    assert map.degree() == 1
    assert np.linalg.norm(map.sphere - target, axis=1).mean() < 0.1


def test_crowded_start_is_spread(dumbbell):
    start = unit(dumbbell.vertices)
    # The left half is crowded into a cap of a thousandth of the sphere.
    crowded = unit(np.where(start[:, :1] < 0, start * np.array([1, 0.02, 0.02]), start))
    map = NewtonRefinement()(dumbbell, crowded)
    assert map.diagnostics["bad_faces"] == 0
    assert map.distortion().max < 10


def test_floor_lowers_the_distortion_of_the_smallest_faces():
    # A thorn on the sphere whose faces have a hundredth of the mean area.
    ball = icosphere(3)
    foot = ball.vertices[5]
    away = np.linalg.norm(ball.vertices - foot, axis=1)[:, None]
    height = 0.06 * np.maximum(0, 1 - away / 0.35)
    tip = foot + 0.05 * (ball.vertices - foot) + height * foot
    thorn = Mesh(np.where(away < 0.35, tip, ball.vertices), ball.faces, "thorn")
    assert thorn.face_areas.min() < 0.01 * thorn.face_areas.mean()
    by_area, floored = (
        NewtonRefinement(floor=floor, tolerance=1e-7)(thorn, ball.vertices).distortion()
        for floor in (0.0, 0.3)
    )
    assert floored.max < 0.95 * by_area.max
    assert floored.mean < by_area.mean
    assert floored.area_weighted_mean < 1.005 * by_area.area_weighted_mean


def test_a_hopeless_start_is_embedded_anew(bumpy):
    shape = normalize(bumpy)
    collapsed = np.repeat(unit(shape.vertices[:1]), len(shape.vertices), axis=0)
    map = NewtonRefinement(rings=(2,))(bumpy, collapsed)
    assert map.diagnostics["rung"] == HIERARCHICAL
    assert map.certify()


def test_a_flow_that_ends_in_one_point_is_embedded_anew(bumpy, monkeypatch):
    """Nothing can be centred, nor untangled."""
    monkeypatch.setattr("gensp.methods.cmcf.unit", lambda x: np.tile([0, 0, 1.0], (len(x), 1)))
    map = CMCF(CertifiedRefinement())(bumpy)
    assert map.diagnostics["rung"] == "hierarchical"
    assert map.certify()


def test_methods_travel_to_workers(bumpy):
    method = CMCF(NewtonRefinement(max_iterations=3))
    again = pickle.loads(pickle.dumps(method))
    np.testing.assert_array_equal(again(bumpy).sphere, method(bumpy).sphere)


def test_a_flow_that_leaves_hairs_is_embedded_anew():
    """A wavy capsule: no face of the start is folded, but no step from there gets anywhere."""
    capsule = trimesh.creation.capsule(height=3, radius=1, count=[16, 16])
    x, _, z = np.asarray(capsule.vertices).T
    waves = 0.15 * np.sin(6 * x) * np.sin(5 * z)
    vertices = capsule.vertices + waves[:, None] * capsule.vertex_normals
    wavy = Mesh(np.array(vertices), np.array(capsule.faces, dtype=np.int64), "wavy")
    found = CMCF(CertifiedRefinement())(wavy)
    assert found.certify()
    assert found.diagnostics["converged"]
    assert found.diagnostics["rung"] == HIERARCHICAL
    assert found.distortion().mean < 1.2


def test_a_map_that_cannot_be_embedded_anew_is_not_lost(bumpy, monkeypatch):
    """It has no fold, and says that it did not converge."""

    def refused(*_, **__):
        raise NotEmbeddable("nothing grows here")

    monkeypatch.setattr("gensp.methods.refinement.embed", refused)
    found = CertifiedRefinement(max_iterations=1)(bumpy, unit(bumpy.vertices))
    assert found.certify()
    assert found.diagnostics["converged"] is False
    assert found.diagnostics["rung"] == PREDICTION
