"""Methods whose result is taken as it is: rigidity, the way through the plane, the raw flow."""

import pickle
from pathlib import Path

import hydra
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.alignment import best_rotation
from gensp.geometry.flow import StepSchedule, cmcf
from gensp.geometry.mesh import load_mesh, normalize
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import icosphere, unit
from gensp.methods.arap import ARAP
from gensp.methods.cmcf import CMCF
from gensp.methods.planar import PlanarReduction
from gensp.methods.refinement import NewtonRefinement, NoRefinement

HEAD = Path(__file__).parents[1] / "data/heads/meshes/id014_expr.ply"
FLOW = CMCF(NoRefinement(), StepSchedule(0.4, 1.0, 0.4), 30, 0.0, intrinsic=False, patience=None)
METHODS = {
    "arap": ARAP(CMCF(NewtonRefinement(max_iterations=15))),
    "vc25": PlanarReduction(),
    "cmcf": FLOW,
}


@pytest.fixture(params=METHODS)
def method(request):
    return METHODS[request.param]


def test_map_keeps_coordinates_and_counts_its_folds(method, limbed):
    moved = limbed.with_vertices(7 * limbed.vertices + 100)
    map = method(moved)
    np.testing.assert_array_equal(map.surface, moved.vertices)
    np.testing.assert_allclose(np.linalg.norm(map.sphere, axis=1), 1)
    assert map.name == "limbed"
    assert map.diagnostics["bad_faces"] == bad_faces(map.sphere, map.faces).sum()
    assert map.diagnostics["seconds"] > 0
    assert map.degree() == 1


def test_similarities_of_the_shape_turn_the_map_at_most(method, bumpy):
    turn = Rotation.from_rotvec([0.4, 1.0, -2.0]).as_matrix()
    map, moved = method(bumpy), method(bumpy.with_vertices(3 * bumpy.vertices @ turn.T - 1))
    rotation = best_rotation(map.sphere, moved.sphere)
    np.testing.assert_allclose(moved.sphere, map.sphere @ rotation.T, atol=1e-4)


def test_methods_travel_to_workers(method, bumpy):
    again = pickle.loads(pickle.dumps(method))
    np.testing.assert_array_equal(again(bumpy).sphere, method(bumpy).sphere)


def test_distortion_is_less_than_that_of_the_flow(limbed):
    raw, rigid, planar = (METHODS[name](limbed).distortion() for name in ("cmcf", "arap", "vc25"))
    assert rigid.area_weighted_mean < 0.5 * raw.area_weighted_mean
    assert planar.max < 0.1 * raw.max


def test_folds_of_the_start_are_told(limbed):
    map = ARAP(FLOW)(limbed)
    assert map.diagnostics["bad_faces_start"] == FLOW(limbed).bad_faces().sum()


def test_unrefined_flow_is_the_flows_end_up_to_its_centring(bumpy):
    flow = cmcf(
        normalize(bumpy),
        step=FLOW.step,
        max_steps=30,
        tolerance=0.0,
        intrinsic=False,
        patience=None,
    )
    assert flow.reason == "steps"
    assert len(flow.times) == 31
    map, end = FLOW(bumpy).sphere, unit(flow.vertices[-1])
    # Möbius maps keep the cross-ratio of four distances.
    quadruples = np.random.default_rng(0).permutation(len(end))[:600].reshape(4, -1)

    def ratio(u):
        a, b, c, d = u[quadruples]
        far = [np.linalg.norm(x - y, axis=1) for x, y in ((a, c), (b, d), (b, c), (a, d))]
        return far[0] * far[1] / (far[2] * far[3])

    np.testing.assert_allclose(ratio(map), ratio(end), rtol=1e-8)


def test_flow_of_a_ball_is_the_ball():
    ball = icosphere(3)
    np.testing.assert_allclose(FLOW(ball).sphere, ball.vertices, atol=1e-3)


def test_the_flow_is_that_of_its_authors_program() -> None:
    """Distortions of Kazhdan's SphereMap after 100 steps, to the six digits that are known."""
    with hydra.initialize_config_module("conf", version_base="1.3"):
        method = hydra.utils.instantiate(
            hydra.compose("config", ["method=cmcf_raw"]).method.object
        )
    found = method()(load_mesh(HEAD)).distortion()
    theirs = (2.19873, 52.2041, 1.05391, 7.70332)
    ours = (found.mean, found.max, found.conformal_mean, found.conformal_max)
    np.testing.assert_allclose(ours, theirs, rtol=5e-6)
