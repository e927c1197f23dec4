import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.errors import RegistrationFailed
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize, simplify
from gensp.geometry.registration import (
    Acceptance,
    RegistrationSettings,
    folded,
    register,
    register_with_retries,
)
from gensp.geometry.sphere import icosphere

QUICK = RegistrationSettings(schedule=((10.0, 4), (1.0, 3), (0.1, 3)))


@pytest.fixture
def limbed() -> Mesh:
    """A ball with four limbs, none a mirror image of another."""
    ball = icosphere(3)
    radius = np.full(len(ball.vertices), 0.5)
    tips = [(1, 0.2, 0.1, 1.5), (-1, 0.3, -0.2, 1.2), (0.1, 1, 0.5, 0.8), (-0.3, -0.7, 0.8, 1.0)]
    for *direction, length in tips:
        axis = np.array(direction) / np.linalg.norm(direction)
        radius += length * np.exp(-14 * (1 - ball.vertices @ axis))
    return Mesh(ball.vertices * radius[:, None], ball.faces, "limbed")


def steps(name: str = "schedule") -> int:
    return sum(count for _, count in getattr(RegistrationSettings(), name))


def turned(mesh: Mesh, degrees: float = 8, shift: tuple[float, ...] = (0.05, -0.03, 0.04)) -> Mesh:
    rotation = Rotation.from_euler("xyz", [degrees, -degrees, degrees / 2], degrees=True)
    return mesh.with_vertices(rotation.apply(mesh.vertices) + np.array(shift))


def bend(mesh: Mesh, amount: float) -> Mesh:
    """Bend along x by a circular arc: nearly isometric, known for every vertex."""
    x, y, z = mesh.vertices.T
    angle = amount * x
    return mesh.with_vertices(
        np.stack([(1 / amount + z) * np.sin(angle), y, (1 / amount + z) * np.cos(angle)], axis=1)
        - np.array([0, 0, 1 / amount])
    )


def remeshed(mesh: Mesh, seed: int = 0) -> Mesh:
    """Same shape, other vertices: order shuffled and vertices slid inside their rings."""
    generator = np.random.default_rng(seed)
    order = generator.permutation(len(mesh.vertices))
    ring = mesh.vertices + 0.3 * _towards_a_neighbour(mesh)
    return Mesh(closest_point(ring, mesh).points[order], np.argsort(order)[mesh.faces], "remeshed")


def _towards_a_neighbour(mesh: Mesh) -> np.ndarray:
    step = np.zeros_like(mesh.vertices)
    step[mesh.faces[:, 0]] = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
    return step


def test_a_mesh_registered_to_itself_stays(bumpy: Mesh) -> None:
    result = register(bumpy, [bumpy], settings=QUICK)
    np.testing.assert_allclose(result.vertices, bumpy.vertices, atol=1e-9)
    assert result.residual < 1e-9
    assert result.coverage < 1e-9
    assert result.fold_rate == 0
    assert result.converged
    assert result.iterations == 10


def test_a_rigid_motion_is_found(limbed: Mesh) -> None:
    target = turned(limbed, 12)
    result = register(limbed, [remeshed(target)])
    assert np.linalg.norm(limbed.vertices - target.vertices, axis=1).mean() > 0.15
    error = np.linalg.norm(result.vertices - target.vertices, axis=1).mean()
    # The remeshed target is another polyhedron; what remains is within its chords.
    assert error < 0.15 * np.linalg.norm(limbed.vertices - target.vertices, axis=1).mean()


def test_a_bend_is_found_with_its_correspondence(dumbbell: Mesh) -> None:
    target = bend(dumbbell, 0.35)
    result = register(dumbbell, [remeshed(target)])
    before = np.linalg.norm(dumbbell.vertices - target.vertices, axis=1).mean()
    after = np.linalg.norm(result.vertices - target.vertices, axis=1).mean()
    assert after < 0.35 * before
    assert result.residual < 0.01
    assert result.coverage_max < 0.02
    assert result.fold_rate == 0


def test_interpolants_guide_a_large_bend(dumbbell: Mesh) -> None:
    target = bend(dumbbell, 1.1)
    between = [bend(dumbbell, amount) for amount in (0.36, 0.73)]
    direct = register(dumbbell, [target])
    guided = register(dumbbell, [*between, target])
    error = [
        np.linalg.norm(result.vertices - target.vertices, axis=1).mean()
        for result in (direct, guided)
    ]
    assert error[1] < 0.9 * error[0]
    assert guided.fold_rate < direct.fold_rate
    assert guided.iterations == steps() + 2 * steps("approach")


def test_the_rest_shape_is_the_source_for_the_whole_edge(dumbbell: Mesh) -> None:
    swollen = dumbbell.with_vertices(dumbbell.vertices * np.array([1.2, 1, 1]))
    there = register(dumbbell, [swollen], settings=QUICK)
    kept = register(dumbbell, [swollen, dumbbell], settings=QUICK)
    reset = register(dumbbell.with_vertices(there.vertices), [dumbbell], settings=QUICK)
    error = [
        np.linalg.norm(result.vertices - dumbbell.vertices, axis=1).mean()
        for result in (kept, reset)
    ]
    assert error[0] < 0.7 * error[1]


def test_moving_or_scaling_both_moves_or_scales_the_result(bumpy: Mesh, ellipsoid: Mesh) -> None:
    # Turned against each other, so that no symmetry leaves two closest points.
    source, target = normalize(turned(bumpy, 20)), normalize(ellipsoid)
    result = register(source, [target], settings=QUICK)
    rotation = Rotation.from_euler("xyz", [70, -40, 160], degrees=True).as_matrix()

    def moved(mesh: Mesh) -> Mesh:
        return mesh.with_vertices(2.5 * mesh.vertices @ rotation.T + np.array([3.0, -1, 2]))

    again = register(moved(source), [moved(target)], settings=QUICK)
    expected = 2.5 * result.vertices @ rotation.T + np.array([3.0, -1, 2])
    np.testing.assert_allclose(again.vertices, expected, atol=1e-7)
    assert again.residual == pytest.approx(result.residual, abs=1e-7)
    assert again.coverage == pytest.approx(result.coverage, abs=1e-7)
    assert again.fold_rate == result.fold_rate


def test_both_sides_pull_a_limb_out() -> None:
    ball = normalize(icosphere(3))
    spike = 1 + 1.2 * np.exp(-12 * (1 - ball.vertices[:, 0]))
    limbed = Mesh(ball.vertices * spike[:, None], ball.faces, "limbed")
    both = register(ball, [limbed])
    one = register(ball, [limbed], settings=RegistrationSettings(two_sided=False))
    assert both.coverage_max < one.coverage_max


def test_folded_faces_are_counted(bumpy: Mesh) -> None:
    flipped = bumpy.faces.copy()
    flipped[:7] = flipped[:7, ::-1]
    assert folded(Mesh(bumpy.vertices, flipped), bumpy.face_normals).sum() == 7
    collapsed = bumpy.vertices.copy()
    collapsed[bumpy.faces[0]] = collapsed[bumpy.faces[0, 0]]
    # The face itself and those that share one of its sides have no area left.
    assert folded(Mesh(collapsed, bumpy.faces), bumpy.face_normals).sum() >= 4


def test_the_ladder_stops_at_the_first_rung_that_is_good_enough(bumpy: Mesh) -> None:
    attempts = register_with_retries(
        bumpy, turned(bumpy), ladder=[QUICK, QUICK], acceptance=Acceptance()
    )
    assert attempts.accepted
    assert attempts.complaints == ("",)


def test_the_ladder_reports_every_rung_and_asks_for_interpolants(dumbbell: Mesh) -> None:
    asked = []

    def interpolate(count: int) -> list[Mesh]:
        asked.append(count)
        return [bend(dumbbell, 1.1 * k / (count + 1)) for k in range(1, count + 1)]

    target = bend(dumbbell, 1.1)
    strict = Acceptance(residual=0.02, coverage=0.02, fold_rate=0.001)
    attempts = register_with_retries(
        dumbbell,
        target,
        ladder=[RegistrationSettings(), RegistrationSettings(interpolants=3)],
        acceptance=strict,
        interpolate=interpolate,
    )
    assert asked == [3]
    assert len(attempts.complaints) == 2
    assert "above 0.0" in attempts.complaints[0]
    assert attempts.accepted
    assert attempts.best.iterations == steps() + 3 * steps("approach")


def test_a_hopeless_edge_is_never_accepted(bumpy: Mesh) -> None:
    far = bumpy.with_vertices(bumpy.vertices @ np.diag([-1.0, 1, 1]) + np.array([4.0, 0, 0]))
    attempts = register_with_retries(bumpy, far, ladder=[QUICK], acceptance=Acceptance())
    assert not attempts.accepted
    assert attempts.complaints[-1] != ""


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_diverged_registration_says_so(bumpy: Mesh) -> None:
    broken = bumpy.with_vertices(np.where(bumpy.vertices > 1, np.nan, bumpy.vertices))
    with pytest.raises(RegistrationFailed, match=r"bumpy: the registration diverged .* start"):
        register_with_retries(bumpy, broken, ladder=[QUICK], acceptance=Acceptance())


def test_resolutions_may_differ(bumpy: Mesh) -> None:
    coarse = simplify(bumpy, 300)
    result = register(coarse, [bumpy], settings=QUICK)
    assert len(result.vertices) == len(coarse.vertices)
    assert result.residual < 0.005
    assert result.fold_rate == 0


def test_a_flat_triangle_of_the_source_has_no_stiffness(bumpy):
    """A source that is flat in one place registers to itself all the same."""
    flat = bumpy.vertices.copy()
    flat[bumpy.faces[0]] = flat[bumpy.faces[0]].mean(axis=0)
    found = register(bumpy.with_vertices(flat), [bumpy])
    assert np.isfinite(found.vertices).all()
    assert found.residual < 0.01
