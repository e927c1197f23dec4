import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from compare import different

from gensp.compute import run_items
from gensp.data.items import item_path
from gensp.errors import RegistrationFailed
from gensp.files import load_npz, read_json, save_npz, write_json
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.machine import noted_peak_memories
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.correspond import CorrespondStage
from gensp.tasks.correspond import correspond_items, correspond_task
from gensp.tasks.joining import joined_parents

SETTINGS = {
    "guided": True,
    "tree": "minimum",
    "registration": {"schedule": [[10.0, 3], [1.0, 2], [0.1, 2]]},
    "retries": [{"normal_agreement": 0.0}],
    "acceptance": {"residual": 0.03, "coverage": 0.03, "fold_rate": 0.05},
    "level_sets": {"resolution": 24, "vertices": 300},
    "sphere_level": 3,
}


def stretched(amount: float) -> Mesh:
    ball = icosphere(3)
    return normalize(Mesh(ball.vertices * np.array([1 + amount, 1, 1 - amount / 3]), ball.faces))


SHAPES = {
    "a": stretched(0.6),
    "a@0": stretched(0.2),
    "a@1": stretched(0.4),
    "b": stretched(0.8),
    "b@0": stretched(-0.3),
}
CODES = {"sphere": 0.0, "a": 0.6, "a@0": 0.2, "a@1": 0.4, "b": 0.8, "b@0": -0.3}


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Run]:
    """What augment and implicit leave: two inputs on one line from the sphere, one dead branch."""
    augment, implicit = tmp_path / "augment", tmp_path / "implicit"
    for id, mesh in SHAPES.items():
        save_npz(item_path(augment, id), vertices=mesh.vertices, faces=mesh.faces)
    codes = np.array([[code, 0.0] for code in CODES.values()], dtype=np.float32)
    save_npz(implicit / "latents.npz", ids=np.array(list(CODES)), codes=codes)
    return {"augment": Run(augment), "implicit": Run(implicit)}


def run(inputs: dict[str, Run], folder: Path, **changes: object) -> CorrespondStage:
    def task(**places: object):
        return correspond_task(**places, **{**SETTINGS, **changes})

    items = correspond_items(inputs=inputs, folder=folder, task=task)
    list(run_items(task(inputs=inputs, folder=folder), items, folder, Workers(jobs=1)))
    return CorrespondStage.from_runs(
        inputs, folder, task=task, level=2, workers=Workers(jobs=1, backend="sequential")
    )


def turn_inside_out(inputs: dict[str, Run], id: str) -> None:
    """Make an item a shape that nothing can be registered to."""
    far = SHAPES[id].vertices + np.array([9.0, 0, 0])
    faces = np.ascontiguousarray(SHAPES[id].faces[:, ::-1])
    save_npz(item_path(inputs["augment"].folder, id), vertices=far, faces=faces)


def test_the_icosphere_reaches_every_input_through_its_ancestors(
    inputs: dict[str, Run], tmp_path: Path
) -> None:
    folder = tmp_path / "correspond"
    metrics = run(inputs, folder).finish()
    tree = read_json(folder / "tree.json")
    parents = {id: tree["ids"][p] for id, p in zip(tree["ids"], tree["parent"], strict=True)}
    assert [parents[id] for id in ("a@0", "a@1", "a", "b")] == ["sphere", "a@0", "a@1", "a"]
    used = {id for id, mark in zip(tree["ids"], tree["used"], strict=True) if mark}
    assert used == {"sphere", "a", "a@0", "a@1", "b"}
    written = {path.stem for path in (folder / "correspondences").iterdir()}
    assert written == {"a", "a@0", "a@1", "b"}
    found = load_npz(folder / "correspondences" / "b.npz")
    assert found["points"].shape == (162, 3)
    assert found["valid"].all()
    # Registration slides along the surface, but a stretch leaves every vertex on its side.
    expected = SHAPES["b"].vertices[:162]
    assert np.linalg.norm(found["points"] - expected, axis=1).mean() < 0.25
    assert closest_point(found["points"], SHAPES["b"]).distance.max() < 1e-9
    assert next(iter(metrics)) == "coverage"
    assert metrics["coverage"] < 0.02
    assert metrics["depth"] == 3.5
    assert metrics["fold_rate"] == 0
    assert metrics["rejected"] == 0
    assert (folder / "edges.csv").read_text().startswith("id,parent,accepted,residual")
    assert "a@1" in (folder / "shapes.csv").read_text()


def test_without_guided_paths_all_inputs_hang_on_the_sphere(
    inputs: dict[str, Run], tmp_path: Path
) -> None:
    folder = tmp_path / "correspond"
    stage = run(inputs, folder, guided=False)
    assert stage.task.shapes.edges == {"a": "sphere", "b": "sphere"}
    assert stage.alternatives == 0
    assert stage.finish()["depth"] == 1
    assert {path.stem for path in (folder / "correspondences").iterdir()} == {"a", "b"}


def test_a_failed_edge_is_joined_elsewhere_and_said_to_be(
    inputs: dict[str, Run], tmp_path: Path
) -> None:
    folder = tmp_path / "correspond"
    # The node on the way to both inputs is a shape that nothing can be registered to.
    turn_inside_out(inputs, "a@1")
    metrics = run(inputs, folder).finish()
    tree = read_json(folder / "tree.json")
    parents = {id: tree["ids"][p] for id, p in zip(tree["ids"], tree["parent"], strict=True)}
    assert parents["a"] == "a@0"
    assert parents["b"] == "a"
    used = {id for id, mark in zip(tree["ids"], tree["used"], strict=True) if mark}
    assert "a@1" not in used
    assert {path.stem for path in (folder / "correspondences").iterdir()} == {"a", "a@0", "b"}
    assert metrics["joined_elsewhere"] == 1
    assert metrics["rejected"] == 1
    edges = (folder / "edges.csv").read_text()
    assert "joined_elsewhere" in edges
    # Again, as after an interruption: nothing changes.
    assert run(inputs, folder).finish()["joined_elsewhere"] == 1
    assert read_json(folder / "tree.json") == tree


def test_killed_before_any_write_the_ending_goes_on_to_the_same_result(
    inputs: dict[str, Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn_inside_out(inputs, "a@1")
    registered, whole = tmp_path / "registered", tmp_path / "whole"
    run(inputs, registered)
    shutil.copytree(registered, whole)
    run(inputs, whole).finish()
    replace, left = os.replace, 0

    def killed(*paths: Path) -> None:
        nonlocal left
        if left == 0:
            raise KeyboardInterrupt
        left -= 1
        replace(*paths)

    for writes in range(100):
        folder = tmp_path / f"killed{writes}"
        shutil.copytree(registered, folder)
        stage, left = run(inputs, folder), writes
        monkeypatch.setattr(os, "replace", killed)
        try:
            stage.finish()
            break
        except KeyboardInterrupt:
            monkeypatch.setattr(os, "replace", replace)
        run(inputs, folder).finish()
        assert different(folder, whole) == []
    # Two other parents with edge and row each, and the tables of the stage.
    assert 8 < writes < 99


def test_other_parents_are_tried_by_the_workers(inputs: dict[str, Run], tmp_path: Path) -> None:
    turn_inside_out(inputs, "a@1")
    alone, shared = tmp_path / "alone", tmp_path / "shared"
    run(inputs, alone).finish()
    stage = run(inputs, shared)
    stage.workers = Workers(jobs=2)
    stage.finish()
    assert noted_peak_memories(shared)  # they are taken up when the folder is sealed
    assert different(alone, shared) == []
    tried = {path.stem for path in (shared / "alternatives" / "rows").iterdir()}
    assert tried == {"a@1%2Fsphere", "a%2Fa@0", "a%2Fsphere"}


def test_rounds_try_what_does_not_depend_on_each_other_together(inputs: dict[str, Run]) -> None:
    shapes = correspond_task(inputs=inputs, folder=Path(), **SETTINGS).shapes
    # sphere → a@0 → a@1 → a → b
    rounds: list[list[tuple[str, str]]] = []

    def register(trials: list[tuple[str, str]]) -> dict[tuple[str, str], bool]:
        rounds.append(trials)
        return {trial: trial in (("a", "sphere"), ("b", "a@0")) for trial in trials}

    found = joined_parents(shapes, {"a@0", "a"}, 3, register)
    # The edge to a@1 failed, and the one to b; a waits for a@1, b for nothing.
    assert rounds[0] == [("a@1", "sphere"), ("b", "a@0"), ("b", "sphere")]
    assert rounds[1] == [("a", "a@0"), ("a", "sphere")]
    assert len(rounds) == 2
    assert found == {"a@0": "sphere", "a": "sphere", "b": "a@0"}
    assert joined_parents(shapes, set(), 0, register) == {}


def test_a_lost_input_is_said_to_be_left_out(
    inputs: dict[str, Run], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turn_inside_out(inputs, "b")
    stage = run(inputs, tmp_path / "correspond")
    stage.max_failures = 1
    assert stage.finish()["lost"] == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "warning" in line]
    assert "1 input shapes (b) have no accepted registration and are not learnt from" in line
    assert line.endswith("shapes.csv")


def test_a_lost_input_is_an_error_with_its_remedy(inputs: dict[str, Run], tmp_path: Path) -> None:
    turn_inside_out(inputs, "b")
    stage = run(inputs, tmp_path / "correspond")
    with pytest.raises(RegistrationFailed, match=r"1 input shapes \(b\) have no .*max_failures"):
        stage.finish()
    assert "b,,,,,,,no registration" in (tmp_path / "correspond" / "shapes.csv").read_text()
    stage.max_failures = 1
    assert stage.finish()["rejected"] == 1


def test_an_edge_leaves_its_numbers(inputs: dict[str, Run], tmp_path: Path) -> None:
    stage = run(inputs, tmp_path / "correspond")
    row = next(row for row in stage.rows if row["id"] == "a")
    assert row["parent"] == "a@1"
    assert row["accepted"] is True
    assert row["attempts"] == 1
    assert row["interpolants"] == ""
    assert {"residual", "coverage", "fold_rate", "converged", "iterations", "seconds"} <= set(row)
    edge = load_npz(tmp_path / "correspond" / "edges" / "a.npz")
    assert edge["vertices"].shape == SHAPES["a@1"].vertices.shape
    assert float(edge["residual"]) == row["residual"]


def test_interpolants_are_level_sets_of_the_implicit_model(
    inputs: dict[str, Run], tmp_path: Path
) -> None:
    from gensp.models import ImplicitField, save_model

    field = ImplicitField(2, width=8, depth=2)
    for weight in field.parameters():
        weight.data.zero_()
    save_model(inputs["implicit"].folder / "model.pt", field=field)
    task = correspond_task(
        inputs=inputs,
        folder=tmp_path,
        **{**SETTINGS, "registration": {**SETTINGS["registration"], "interpolants": 2}},
    )
    # A network of zeros leaves f = |x| - 1: every level set is the unit sphere.
    between = task._between("a@1", "a", 2)
    assert len(between) == 2
    assert np.abs(np.linalg.norm(between[0].vertices, axis=1) - 1).max() < 0.05
    row = task("a")
    assert row["iterations"] > 7
    assert row["interpolants"] == "2 of 2"
    # One that has no level set inside the box.
    field.trunk.last.bias.data.fill_(50.0)
    save_model(inputs["implicit"].folder / "model.pt", field=field)
    assert task("b")["interpolants"] == "0 of 2"


def test_the_task_travels_to_workers(inputs: dict[str, Run], tmp_path: Path) -> None:
    task = correspond_task(inputs=inputs, folder=tmp_path, **SETTINGS)
    assert pickle.loads(pickle.dumps(task)).shapes.edges == task.shapes.edges
    write_json(tmp_path / "edges.json", task.shapes.edges)
