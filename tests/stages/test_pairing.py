import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gensp.compute import run_items
from gensp.data.items import item_path
from gensp.errors import RegistrationFailed
from gensp.files import load_npz, read_json, read_rows, save_npz
from gensp.geometry.certificate import certify
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, unit
from gensp.models import Atlas
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.pairing import PairedStage
from gensp.tasks.pairing import SHARED, pairing_items, pairing_task

SERIAL = Workers(jobs=1, backend="sequential")
SETTINGS = {
    "guided": True,
    "neighbours": 1,
    "guides": 2,
    "registration": {},
    "schedule": [[30.0, 6], [3.0, 3], [0.3, 3], [0.1, 2]],
    "settle_from": 3.0,
    "acceptance": {"residual": 0.05, "coverage": 0.05, "fold_rate": 0.05},
}
BALL = icosphere(3)
FEET = unit(np.array([[0.0, 0.3, -1.0], [0.9, -0.2, 0.5], [-0.7, 0.6, 0.6]]))


def legged(*lengths: float) -> Mesh:
    """A ball with three legs; vertices correspond."""
    squared = np.sum((BALL.vertices[:, None] - FEET) ** 2, axis=2)
    legs = (np.exp(-squared / 0.1) * np.array(lengths)) @ FEET
    return normalize(Mesh(BALL.vertices + legs, BALL.faces))


TURN = Rotation.from_rotvec([0.0, 2.2, 0.5])
SHAPES = {
    "a": legged(1.2, 0.7, 0.3),
    "b": legged(1.1, 0.8, 0.3),
    "c": legged(1.0, 0.7, 0.4),
}
SHAPES["turned"] = SHAPES["a"].with_vertices(TURN.apply(SHAPES["b"].vertices))
CODES = {"sphere": 0.0, "a": 1.0, "a@0": 0.5, "b": 1.2, "c": 1.3, "turned": 3.0}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """What augment and implicit leave; "turned" looks the other way and has a far code."""
    runs = tmp_path_factory.mktemp("inputs")
    augment, implicit = runs / "augment", runs / "implicit"
    for id, mesh in SHAPES.items():
        save_npz(item_path(augment, id), vertices=mesh.vertices, faces=mesh.faces)
    codes = np.array([[code, 0.0] for code in CODES.values()], dtype=np.float32)
    save_npz(implicit / "latents.npz", ids=np.array(list(CODES)), codes=codes)
    return {"augment": Run(augment), "implicit": Run(implicit)}


def run(inputs: dict[str, Run], folder: Path, **changes: object) -> PairedStage:
    task = partial(pairing_task, **{**SETTINGS, **changes})
    items = pairing_items(inputs=inputs, folder=folder, task=task)
    list(run_items(task(inputs=inputs, folder=folder), items, folder, SERIAL))
    numbers = {"level": 4, "placement": {"energy": "sigma", "floor": 1.0}}
    return PairedStage.from_runs(inputs, folder, task=task, workers=SERIAL, **numbers)


@dataclass(frozen=True)
class Finished:
    folder: Path
    metrics: dict[str, float]


@pytest.fixture(scope="module")
def finished(inputs: dict[str, Run], tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The stage with its default settings; to be read only."""
    folder = tmp_path_factory.mktemp("finished") / "correspond"
    return Finished(folder, run(inputs, folder).finish())


def test_every_input_is_reached_and_corresponds(finished: Finished) -> None:
    folder, metrics = finished.folder, finished.metrics
    assert metrics["lost"] == metrics["rejected"] == 0
    assert {row["id"] for row in read_rows(folder / "shapes.csv")} == set(SHAPES)
    points = {id: load_npz(folder / "correspondences" / f"{id}.npz")["points"] for id in SHAPES}
    # One icosphere point is one vertex of the template, on every shape; the second is turned.
    template = {
        id: closest_point(places, SHAPES[id]).at.on(BALL.vertices, BALL.faces)
        for id, places in points.items()
    }
    for id in SHAPES:
        gap = np.linalg.norm(unit(template[id]) - unit(template["a"]), axis=1)
        assert gap.mean() < 0.06, id


def test_the_tree_is_written_as_the_other_kind(finished: Finished) -> None:
    tree = read_json(finished.folder / "tree.json")
    assert tree["ids"] == ["sphere", *SHAPES]
    assert tree["parent"][0] == -1
    assert tree["parent"].count(0) == 1
    assert all(tree["used"])
    rows = read_rows(finished.folder / "edges.csv")
    pairs = {frozenset(row["id"].split("/")) for row in rows}
    ids = tree["ids"]
    for child, parent in zip(ids[1:], tree["parent"][1:], strict=True):
        assert parent == 0 or frozenset({child, ids[parent]}) in pairs


def test_the_shared_surface_is_bijective_and_becomes_the_models_atlas(
    finished: Finished,
) -> None:
    shared = load_npz(finished.folder / SHARED)
    assert certify(shared["sphere"], shared["faces"]).bijective
    for id, image in zip(shared["ids"], shared["images"], strict=True):
        assert closest_point(image, SHAPES[str(id)]).distance.mean() < 0.03
    atlas = Atlas.of(shared, torch.eye(4))
    np.testing.assert_allclose(atlas.images.numpy(), shared["images"], atol=1e-6)
    assert atlas.codes.shape == (4, 4)


def test_a_second_run_repeats_nothing_and_ends_alike(
    inputs: dict[str, Run], finished: Finished, tmp_path: Path
) -> None:
    folder = tmp_path / "correspond"
    shutil.copytree(finished.folder, folder)
    times = {path: path.stat().st_mtime_ns for path in folder.glob("edges/*/*.npz")}
    assert times
    assert run(inputs, folder).finish() == finished.metrics
    assert times == {path: path.stat().st_mtime_ns for path in folder.glob("edges/*/*.npz")}


def test_without_guided_paths_all_hang_on_one(inputs: dict[str, Run], tmp_path: Path) -> None:
    folder = tmp_path / "correspond"
    run(inputs, folder, guided=False).finish()
    parents = read_json(folder / "tree.json")["parent"]
    assert len(set(parents[1:]) - {0}) == 1


def test_shapes_that_no_registration_reaches_are_named(
    inputs: dict[str, Run], tmp_path: Path
) -> None:
    stage = run(inputs, tmp_path / "correspond", acceptance={"residual": 0.0, "coverage": 0.0})
    with pytest.raises(RegistrationFailed, match=r"3 input shapes .*recipe\.correspond"):
        stage.finish()
    assert "no registration reached it" in (stage.folder / "shapes.csv").read_text()
