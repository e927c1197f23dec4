import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.errors import DegenerateMesh
from gensp.geometry import flow as flow_module
from gensp.geometry.arap import deformation_energy
from gensp.geometry.flow import Flow, StepSchedule, accepted, cmcf, flow_score, sphere_distance
from gensp.geometry.mesh import SPHERE_AREA, Mesh, normalize
from gensp.geometry.operators import cotangent_laplacian, lumped_mass
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.sphere import icosphere, unit


def consistent_mass(mesh: Mesh) -> np.ndarray:
    """∫ φ_i φ_j of linear elements, triangle by triangle."""
    mass = np.zeros((len(mesh.vertices),) * 2)
    for face, area in zip(mesh.faces, mesh.face_areas, strict=True):
        mass[np.ix_(face, face)] += area / 12 * (np.ones((3, 3)) + np.eye(3))
    return mass


@pytest.mark.parametrize("full", [False, True])
def test_first_step_equals_a_dense_solve(bumpy, full):
    flow = cmcf(bumpy, step=StepSchedule(0.1, 1.0), max_steps=1, intrinsic=False, full=full)
    start = normalize(bumpy)
    lumped = np.diag(lumped_mass(start.vertices, start.faces))
    mass = consistent_mass(start) if full else lumped
    matrix = mass + 0.1 * cotangent_laplacian(start).toarray()
    expected = normalize(start.with_vertices(np.linalg.solve(matrix, mass @ start.vertices)))
    np.testing.assert_allclose(flow.vertices[1], expected.vertices, atol=1e-11)


def test_the_sphere_stays_where_it_is():
    flow = cmcf(icosphere(3), tolerance=1e-9, max_steps=5)
    assert flow.sphere_error.max() < 6e-3
    # Its score has neither a distance to S_0 nor a deformation, up to the resolution.
    assert flow_score(flow, icosphere(3), weight=1.0) < 1e-4


def test_a_smooth_shape_reaches_the_sphere_without_folds(bumpy):
    flow = cmcf(bumpy)
    assert flow.converged
    assert flow.reason == "sphere"
    assert flow.sound.all()
    assert flow.sphere_error[-1] < 0.015
    sphere = unit(flow.vertices[-1])
    assert not bad_faces(sphere, flow.faces).any()
    assert map_degree(sphere, flow.faces) == 1


def test_every_shape_is_centred_with_area_of_the_sphere(dumbbell):
    flow = cmcf(dumbbell, max_steps=10, tolerance=1e-6)
    for vertices in flow.vertices:
        shape = Mesh(vertices, flow.faces)
        np.testing.assert_allclose(shape.area, SPHERE_AREA, rtol=1e-12)
        np.testing.assert_allclose(vertices, normalize(shape).vertices, atol=1e-12)


def test_flow_turns_with_the_input_and_forgets_its_scale(bumpy):
    turn = Rotation.from_rotvec([0.3, 1.0, -0.7]).as_matrix()
    flow = cmcf(bumpy, max_steps=8)
    moved = cmcf(bumpy.with_vertices(7 * bumpy.vertices @ turn.T + 2), max_steps=8)
    np.testing.assert_allclose(moved.vertices, flow.vertices @ turn.T, atol=1e-9)
    np.testing.assert_allclose(flow_score(moved, bumpy), flow_score(flow, bumpy), rtol=1e-7)


@pytest.mark.parametrize("full", [False, True])
def test_flow_forgets_the_order_of_the_vertices(bumpy, rng, full):
    order = rng.permutation(len(bumpy.vertices))
    place = np.argsort(order)
    faces = rng.permutation(place[bumpy.faces])
    shuffled = cmcf(Mesh(bumpy.vertices[order], faces), max_steps=8, full=full)
    flow = cmcf(bumpy, max_steps=8, full=full)
    np.testing.assert_allclose(shuffled.vertices, flow.vertices[:, order], atol=1e-9)


def test_vanishing_limbs_are_reported_and_everything_stays_finite(limbed):
    flow = cmcf(limbed)
    assert flow.sound[0]
    assert not flow.sound.all()
    assert np.isfinite(flow.vertices).all()
    assert np.isfinite(flow_score(flow, limbed))
    last_sound = flow.arc_length[np.flatnonzero(flow.sound)[-1]] / flow.arc_length[-1]
    assert 0 < last_sound < 1


def test_flow_is_cut_before_the_step_that_cannot_be_computed(bumpy, monkeypatch):
    honest = flow_module.lumped_mass
    calls = iter(range(100))

    def failing(vertices, faces):
        mass = honest(vertices, faces)
        return mass * np.nan if next(calls) == 4 else mass

    monkeypatch.setattr(flow_module, "lumped_mass", failing)
    flow = cmcf(bumpy, tolerance=1e-6)
    assert flow.reason.startswith("degenerate")
    assert not flow.converged
    assert len(flow.vertices) == len(flow.times) == len(flow.sound) == 5
    assert np.isfinite(flow.vertices).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_what_has_no_area_cannot_flow(bumpy, value):
    with pytest.raises(DegenerateMesh, match="bumpy"):
        cmcf(bumpy.with_vertices(np.full_like(bumpy.vertices, value)))


def test_a_flow_without_a_first_step_is_an_error(bumpy, monkeypatch):
    monkeypatch.setattr(flow_module, "lumped_mass", lambda v, f: np.full(len(v), np.nan))
    with pytest.raises(DegenerateMesh, match="bumpy: degenerate"):
        cmcf(bumpy)


def test_triangles_without_area_do_not_stop_a_flow(bumpy):
    vertices = bumpy.vertices.copy()
    vertices[bumpy.faces[0]] = vertices[bumpy.faces[0, 0]]
    flow = cmcf(bumpy.with_vertices(vertices))
    assert np.isfinite(flow.vertices).all()
    assert flow.converged


def test_a_stalled_flow_ends_at_its_closest_shape(bumpy):
    flow = cmcf(bumpy, tolerance=0.0, max_steps=400)
    assert flow.reason == "stalled"
    assert flow.sphere_error.argmin() == len(flow.sphere_error) - 1


def synthetic(vertices: np.ndarray, arc_length: list[float], faces: np.ndarray) -> Flow:
    steps = np.arange(len(vertices), dtype=float)
    return Flow(vertices, faces, steps, np.array(arc_length), steps, True, "sphere")


def test_positions_are_linear_in_arc_length():
    ball = icosphere(1)
    shapes = np.stack([ball.vertices * s for s in (1.0, 2.0, 5.0)])
    flow = synthetic(shapes, [0.0, 1.0, 4.0], ball.faces)
    scales = flow.at(np.array([0.0, 0.125, 0.25, 0.5, 1.0]))[:, 0] @ ball.vertices[0]
    np.testing.assert_allclose(scales, [1, 1.5, 2, 3, 5], atol=1e-12)


def test_score_of_a_flow_that_swells_has_a_closed_form():
    # S(t) = (1 + t) S_0: the end is 1 away, e_deform is t² of the edge energy.
    ball = normalize(icosphere(4))
    flow = synthetic(np.stack([ball.vertices, 2 * ball.vertices]), [0.0, 1.0], ball.faces)
    distance = 2 * np.linalg.norm(ball.vertices, axis=1).max() - 1
    score = flow_score(flow, ball, weight=0.3, samples=200)
    np.testing.assert_allclose(score, distance**2 + 0.3 / 3, rtol=1e-4)


def test_deformation_in_the_score_is_equation_two(ellipsoid):
    rest = normalize(ellipsoid)
    flow = cmcf(ellipsoid, max_steps=3)
    score = flow_score(flow, ellipsoid, weight=1.0, samples=1)
    middle = flow.at(np.array([0.5]))[0]
    energy = deformation_energy(rest.vertices, middle, rest.faces)
    edges = rest.vertices[rest.edges[:, 0]] - rest.vertices[rest.edges[:, 1]]
    end = sphere_distance(Mesh(flow.vertices[-1], flow.faces))
    np.testing.assert_allclose(score, end**2 + energy / (2 * np.sum(edges**2)), rtol=1e-10)


def test_distance_to_the_sphere_is_two_sided():
    ball = icosphere(4)
    assert sphere_distance(ball) < 2e-3
    np.testing.assert_allclose(sphere_distance(Mesh(1.5 * ball.vertices, ball.faces)), 0.5, 0.01)
    # Half a sphere, closed by a disc: its vertices are near, but the other pole is not.
    half = ball.vertices.copy()
    half[:, 2] = np.maximum(half[:, 2], 0)
    np.testing.assert_allclose(sphere_distance(Mesh(half, ball.faces)), 1.0, atol=0.05)


def test_step_sizes_grow_to_their_cap():
    step = StepSchedule(0.005, 1.2, 0.2)
    np.testing.assert_allclose([step(0), step(1), step(10**6)], [0.005, 0.006, 0.2])
    assert StepSchedule(0.1, 1.0, 0.1)(50) == 0.1
    assert str(step) != str(StepSchedule(0.1, 1.0, 0.1))


def test_scores_below_twice_the_median_are_accepted():
    scores = np.array([1.0, 2.0, 3.0, 3.9, 100.0, np.inf])
    # The median of the finite ones is 3.
    np.testing.assert_array_equal(accepted(scores), [True, True, True, True, False, False])
    np.testing.assert_array_equal(accepted(scores, factor=1.0), [True, True, *[False] * 4])
    assert not accepted(np.array([np.inf, np.nan])).any()


def test_a_flow_without_patience_takes_all_its_steps(bumpy):
    flow = cmcf(bumpy, tolerance=0.0, max_steps=60, patience=None)
    stalled = cmcf(bumpy, tolerance=0.0, max_steps=60)
    assert (flow.reason, len(flow.times)) == ("steps", 61)
    assert stalled.reason == "stalled"
    # The same flow, only longer.
    np.testing.assert_array_equal(flow.vertices[: len(stalled.vertices)], stalled.vertices)
