import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.errors import RegistrationFailed
from gensp.geometry.guided_registration import (
    INVERSE,
    UNGUIDED,
    Guided,
    MappedShape,
    guides,
    posed,
    register_guided,
    restarted,
)
from gensp.geometry.mesh import Mesh, normalize, simplify
from gensp.geometry.registration import RegistrationSettings, register
from gensp.geometry.registration_step import BendingSystem
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.hierarchical import dirichlet

SETTINGS = RegistrationSettings(schedule=((100.0, 6), (10.0, 4), (1.0, 3), (0.1, 3)))
FEET = unit(np.array([[0.0, 0.3, -1.0], [0.9, -0.2, 0.5], [-0.7, 0.6, 0.6]]))
LENGTHS = np.array([1.6, 1.0, 0.5])


def spider(feet: np.ndarray = FEET) -> Mesh:
    """A ball with three legs of different lengths: no rotation takes it to itself."""
    ball = icosphere(4)
    squared = np.sum((ball.vertices[:, None] - FEET) ** 2, axis=2)
    legs = (np.exp(-squared / 0.05) * LENGTHS) @ feet
    return normalize(Mesh(ball.vertices + legs, ball.faces, "spider"))


def mapped(mesh: Mesh) -> MappedShape:
    return MappedShape(dirichlet()(mesh))


@pytest.fixture(scope="module")
def source() -> MappedShape:
    return mapped(simplify(spider(), 900))


def turned(mesh: Mesh, rotation: Rotation) -> Mesh:
    return mesh.with_vertices(rotation.apply(mesh.vertices))


def test_guides_find_a_turned_shape_where_closest_points_do_not(source: MappedShape) -> None:
    turn = Rotation.from_rotvec([0.0, 2.5, 0.6])
    target = mapped(turned(simplify(spider(), 800), turn))
    true = turn.apply(source.mesh.vertices)
    found = register_guided(source, target, settings=SETTINGS)
    plain = register(source.mesh, [target.mesh], settings=SETTINGS)
    assert found.guide >= 0
    assert np.linalg.norm(found.best.vertices - true, axis=1).mean() < 0.03
    assert np.linalg.norm(plain.vertices - true, axis=1).mean() > 0.3
    assert found.best.strain < 0.1 * plain.strain


def test_the_least_strained_of_all_starts_is_taken(source: MappedShape) -> None:
    bent = FEET[[0, 1, 2]] + np.array([[0.5, 0, 0], [0, 0.4, 0], [0, 0, 0]])
    target = mapped(simplify(spider(bent), 800))
    found = register_guided(source, target, settings=SETTINGS, count=2)
    plain = register_guided(source, target, settings=SETTINGS, count=0)
    assert plain.guide == UNGUIDED
    assert found.best.strain <= plain.best.strain
    again = register(source.mesh, [target.mesh], settings=SETTINGS)
    np.testing.assert_allclose(plain.best.vertices, again.vertices, atol=1e-9)


def test_guides_compose_both_maps_with_a_rotation(source: MappedShape) -> None:
    turn = Rotation.from_rotvec([0.4, -0.2, 1.0]).as_matrix()
    other = MappedShape(source.map.rotated(turn))
    positions = guides(source, other, 1)[0]
    np.testing.assert_allclose(positions, source.mesh.vertices, atol=1e-3)


def test_a_pose_forgets_positions_that_the_others_do_not_bear_out(source: MappedShape) -> None:
    wrong = source.mesh.vertices.copy()
    wrong[:15] += 1.5
    pose = posed(BendingSystem(source.mesh, SETTINGS), wrong, SETTINGS, 1.0)
    assert np.linalg.norm(pose[15:] - source.mesh.vertices[15:], axis=1).mean() < 0.02


def test_a_failed_way_is_mended_by_the_way_back(source: MappedShape) -> None:
    turn = Rotation.from_rotvec([0.0, 2.5, 0.6])
    target = mapped(turned(simplify(spider(), 800), turn))
    failed = register_guided(source, target, settings=SETTINGS, count=0)
    back = register_guided(target, source, settings=SETTINGS)
    mended = restarted(source, target, failed, back, settings=SETTINGS)
    assert mended.guide == INVERSE
    true = turn.apply(source.mesh.vertices)
    assert np.linalg.norm(mended.best.vertices - true, axis=1).mean() < 0.03
    assert restarted(target, source, back, failed, settings=SETTINGS) == back


def test_shapes_that_nothing_can_bend_are_reported(source: MappedShape) -> None:
    flat = Mesh(source.mesh.vertices * np.array([1, 1, np.nan]), source.mesh.faces, "flat")
    broken = MappedShape(SphericalMap(source.map.sphere, flat.vertices, flat.faces))
    with pytest.raises(RegistrationFailed, match=r"cannot be bent|diverged"):
        register_guided(broken, source, settings=SETTINGS, count=0)


def test_strain_is_nothing_for_a_rigid_motion_and_one_for_a_point(source: MappedShape) -> None:
    bending = BendingSystem(source.mesh, SETTINGS)
    moved = turned(source.mesh, Rotation.from_rotvec([1.0, 2.0, 0.5])).vertices + 3
    assert bending.strain(moved) < 1e-12
    assert bending.strain(np.zeros_like(moved)) == pytest.approx(1)
    assert isinstance(Guided(register(source.mesh, [source.mesh]), 0).best.strain, float)
