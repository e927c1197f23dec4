"""Further rounds of Stage III-a: from a source shared by all shapes."""

from pathlib import Path

import numpy as np
import pytest

from gensp.data.items import item_path
from gensp.errors import BadMesh
from gensp.files import load_npz, save_npz
from gensp.geometry.correspondence import Correspondence, correspondence
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.registration import Acceptance, RegistrationSettings
from gensp.geometry.sphere import icosphere
from gensp.sharing import Workers
from gensp.tasks.again import Rounds
from gensp.tasks.correspond import LevelSets, RegisterEdge

BALL = icosphere(2)


def stretched(amount: float) -> Mesh:
    ball = icosphere(3)
    return normalize(Mesh(ball.vertices * np.array([1 + amount, 1, 1]), ball.faces))


SHAPES = {"a": stretched(0.5), "b": stretched(0.6), "c": stretched(0.7)}


def turned(id: str, angle: float) -> Correspondence:
    """The icosphere on a shape, slid around the long axis: the bias of a chain."""
    c, s = np.cos(angle), np.sin(angle)
    rays = BALL.vertices @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    mesh = SHAPES[id]
    on_shape = rays * np.abs(mesh.vertices).max(axis=0)
    return correspondence(closest_point(on_shape, mesh).at, mesh, BALL.faces)


@pytest.fixture
def task(tmp_path: Path) -> RegisterEdge:
    for id, mesh in SHAPES.items():
        save_npz(item_path(tmp_path, id), vertices=mesh.vertices, faces=mesh.faces)
    settings = RegistrationSettings(schedule=((10.0, 3), (1.0, 2), (0.1, 2)))
    bounds = Acceptance(0.03, 0.05, 0.05)
    return RegisterEdge(
        tmp_path, tmp_path, tmp_path, "minimum", (settings,), bounds, LevelSets(), 3
    )


def spread(images: dict[str, Correspondence]) -> float:
    """Mean distance of the images' directions around the long axis from their mean."""
    angles = [np.arctan2(*image.points[:, 1:].T) for image in images.values()]
    return float(np.abs(np.angle(np.exp(1j * (angles - angles[1])))).mean())


def test_the_shared_source_takes_away_what_single_chains_added(
    task: RegisterEdge, tmp_path: Path
) -> None:
    carried = {id: turned(id, angle) for id, angle in zip("abc", (-0.2, 0.0, 0.2), strict=True)}
    rounds = Rounds(count=1, workers=Workers(jobs=1))
    agreed, rows = rounds(task, tmp_path, carried)
    assert spread(agreed) < 0.3 * spread(carried)
    assert [row["round"] for row in rows] == [1, 1, 1]
    assert all(row["kept"] and row["residual"] < 0.03 for row in rows)
    for id, image in agreed.items():
        assert closest_point(image.points, SHAPES[id]).distance.max() < 1e-9
    stored = load_npz(tmp_path / "rounds" / "1" / "sources.npz")
    np.testing.assert_allclose(stored["points"][0], stored["points"][2])
    # Again, as after an interruption: rows are kept and give the same images.
    row_files = sorted((tmp_path / "rounds" / "1" / "rows").iterdir())
    before = [path.stat().st_mtime_ns for path in row_files]
    repeated, _ = rounds(task, tmp_path, carried)
    assert [path.stat().st_mtime_ns for path in row_files] == before
    assert all(np.array_equal(repeated[id].points, agreed[id].points) for id in agreed)


def test_a_registration_out_of_bounds_leaves_the_carried_image(
    task: RegisterEdge, tmp_path: Path
) -> None:
    carried = {id: turned(id, 0.0) for id in "ab"}
    away = SHAPES["b"].with_vertices(SHAPES["b"].vertices + np.array([9.0, 0, 0]))
    inverted = np.ascontiguousarray(away.faces[:, ::-1])
    save_npz(item_path(tmp_path, "b"), vertices=away.vertices, faces=inverted)
    agreed, rows = Rounds(count=1, workers=Workers(jobs=1))(task, tmp_path, carried)
    assert agreed["b"] is carried["b"]
    assert [row["kept"] for row in rows] == [True, False]
    assert rows[1]["complaints"]


def test_a_shape_in_error_keeps_the_carried_image(
    task: RegisterEdge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: RegisterEdge, id: str) -> Mesh:
        raise BadMesh(f"{id}: is broken")

    carried = {id: turned(id, 0.0) for id in "ab"}
    monkeypatch.setattr(RegisterEdge, "mesh", broken)
    agreed, rows = Rounds(count=2, workers=Workers(jobs=1))(task, tmp_path, carried)
    assert all(agreed[id] is carried[id] for id in "ab")
    assert [row["error"] for row in rows] == ["a: is broken", "b: is broken"] * 2


def test_no_round_changes_nothing(task: RegisterEdge, tmp_path: Path) -> None:
    carried = {"a": turned("a", 0.1)}
    assert Rounds()(task, tmp_path, carried) == (carried, [])
