import csv
from pathlib import Path

import numpy as np
import pytest
from lightning import Trainer

from gensp.compute import run_items
from gensp.data.items import Item, item_mesh, training_items
from gensp.data.modules import ItemsModule
from gensp.data.shapes import ShapeCollection
from gensp.errors import (
    DamagedFile,
    DegenerateMesh,
    MissingData,
    MissingStage,
    Unsupported,
)
from gensp.files import load_npz, write_json
from gensp.geometry.distance import hausdorff
from gensp.geometry.flow import StepSchedule, cmcf, flow_score
from gensp.geometry.mesh import SPHERE_AREA, Mesh, normalize, require_genus_zero, save_mesh
from gensp.geometry.sphere import icosphere
from gensp.sharing import Workers
from gensp.stages.augment import AugmentStage
from gensp.tasks import augment
from gensp.tasks.augment import AugmentTask, augment_items, augment_task

SETTINGS = {
    "candidates": [{"first": 0.005}, {"first": 1.0, "growth": 1.0, "largest": 1.0}],
    "samples": 3,
    "flow_vertices": 642,
    "training_vertices": 300,
    "score_weight": 1e-3,
    "max_steps": 60,
    "tolerance": 0.03,
    "input_angle": 0.1,
    "sample_angle": 1.0,
    "seed": 0,
}


@pytest.fixture
def collection(
    tmp_path: Path, bumpy: Mesh, ellipsoid: Mesh, dumbbell: Mesh, limbed: Mesh
) -> ShapeCollection:
    root = tmp_path / "shapes"
    splits = {"bumpy": "train", "ellipsoid": "val", "dumbbell": "test", "limbed": "train"}
    for mesh in (bumpy, ellipsoid, dumbbell, limbed):
        save_mesh(mesh, root / "meshes" / f"{mesh.name}.ply")
    rows = "".join(f"meshes/{name}.ply,{split}\n" for name, split in splits.items())
    (root / "manifest.csv").write_text("file,split\n" + rows)
    return ShapeCollection.from_folder(root)


@pytest.fixture
def task(collection: ShapeCollection, tmp_path: Path) -> AugmentTask:
    return augment_task(inputs={}, folder=tmp_path / "augment", collection=collection, **SETTINGS)


def run(task: AugmentTask, **settings: float) -> AugmentStage:
    items = augment_items(inputs={}, folder=task.folder, collection=task.collection)
    list(run_items(task, items, task.folder, Workers(jobs=1)))
    return AugmentStage.from_runs({}, task.folder, collection=task.collection, **settings)


def test_test_shapes_are_never_flowed(collection, tmp_path):
    items = augment_items(inputs={}, folder=tmp_path, collection=collection)
    assert items == ["bumpy", "ellipsoid", "limbed"]


def test_validation_shapes_can_stay_unseen(collection, tmp_path):
    known = {"inputs": {}, "folder": tmp_path, "collection": collection}
    train, val = (augment_items(**known, learn_from=[split]) for split in ("train", "val"))
    assert sorted(train + val) == sorted(augment_items(**known))
    assert train == collection.ids("train")
    with pytest.raises(Unsupported, match="the split test is never learnt from"):
        augment_items(**known, learn_from=["train", "test"])
    with pytest.raises(Unsupported, match="one or both of train, val are required"):
        augment_items(**known, learn_from=[])


def test_splits_without_a_shape_are_refused(tmp_path):
    save_mesh(icosphere(2), tmp_path / "ball.ply")
    (tmp_path / "manifest.csv").write_text("file,split\nball.ply,test\n")
    collection = ShapeCollection.from_folder(tmp_path)
    with pytest.raises(MissingData, match="no shape belongs to train or val"):
        augment_items(inputs={}, folder=tmp_path, collection=collection)


def test_items_are_sound_meshes_between_input_and_sphere(task):
    run(task, acceptance=np.inf).finish()
    items = training_items(task.folder, augmented=True)
    assert len(items) == 3 + 3 * 3
    ball = normalize(icosphere(4))
    for item in items:
        mesh = item_mesh(task.folder, item.id)
        require_genus_zero(mesh)
        np.testing.assert_allclose(mesh.area, SPHERE_AREA, rtol=1e-9)
        np.testing.assert_allclose(mesh.vertices, normalize(mesh).vertices, atol=1e-9)
        assert len(mesh.vertices) <= 300
    way = [hausdorff(item_mesh(task.folder, f"bumpy{k}"), ball) for k in ("", "@0", "@1", "@2")]
    assert way == sorted(way, reverse=True)


def test_samples_are_one_in_every_part_of_the_way_and_seeded(task):
    run(task, acceptance=np.inf).finish()
    for shape in ("bumpy", "limbed"):
        found = [i for i in training_items(task.folder, True) if i.shape == shape]
        assert [item.id for item in found] == [shape, *(f"{shape}@{k}" for k in range(3))]
        assert [int(3 * item.t) for item in found[1:]] == [0, 1, 2]
    assert found[1].t == task._fractions("limbed")[0]
    assert found[1].t != task._fractions("bumpy")[0]


def test_the_candidate_with_the_smallest_score_is_kept(task, collection):
    row = task("bumpy")
    rest = normalize(collection.mesh("bumpy"))
    steps = [StepSchedule(0.005), StepSchedule(1.0, 1.0, 1.0)]
    scores = [
        flow_score(cmcf(rest, step=step, max_steps=60, tolerance=0.03), rest) for step in steps
    ]
    np.testing.assert_allclose(row["score"], min(scores), rtol=1e-6)
    assert row["step"] == str(steps[int(np.argmin(scores))])
    flow = load_npz(task.folder / "flows" / "bumpy.npz")
    assert flow["vertices"].shape == (row["steps"] + 1, 642, 3)
    np.testing.assert_allclose(flow["vertices"][0], rest.vertices, atol=1e-5)


def test_limbs_that_vanish_are_reported(task):
    task = augment_task(
        inputs={},
        folder=task.folder,
        collection=task.collection,
        **SETTINGS | {"flow_vertices": 2562, "training_vertices": 2562, "samples": 4},
    )
    row = task("limbed")
    assert row["geometry_only_from"] < 1
    assert row["geometry_only"] + row["dropped"] > 0
    assert row["kept"] + row["dropped"] == 4
    assert bool(row["dropped"]) == bool(row["dropped_because"])


def test_flows_above_a_multiple_of_the_median_score_are_left_out(task):
    stage = run(task, acceptance=1.01)
    metrics = stage.finish()
    with open(task.folder / "flows.csv", newline="") as file:
        rows = {row["id"]: row for row in csv.DictReader(file)}
    limit = 1.01 * np.median([float(row["score"]) for row in rows.values()])
    for row in rows.values():
        assert (row["accepted"] == "True") == (float(row["score"]) < limit)
    everything = training_items(task.folder, augmented=True)
    assert {item.shape for item in everything if item.kind == "augmented"} == {
        name for name, row in rows.items() if row["accepted"] == "True"
    }
    assert metrics["augmented"] == sum(item.kind == "augmented" for item in everything)
    assert metrics["accepted"] == 2


def test_no_data_augmentation_leaves_the_inputs(task):
    run(task).finish()
    items = training_items(task.folder, augmented=False)
    assert items[0] == Item("bumpy", "bumpy", "train", "input", 0.0)
    assert [item.id for item in items] == ["bumpy", "ellipsoid", "limbed"]
    train = training_items(task.folder, augmented=False, splits=("train",))
    assert [item.id for item in train] == ["bumpy", "limbed"]


def test_items_of_a_missing_stage_name_the_command(tmp_path):
    with pytest.raises(MissingStage, match="stage=augment"):
        training_items(tmp_path, augmented=True)


@pytest.mark.parametrize("id", ["../bumpy", "/bumpy", "a/b"])
def test_an_id_that_leads_out_of_the_folder_is_refused(tmp_path, id):
    entry = {"id": id, "shape": "bumpy", "split": "train", "kind": "input", "t": 0.0}
    write_json(tmp_path / "items.json", [entry])
    with pytest.raises(DamagedFile, match="plain file name"):
        training_items(tmp_path, augmented=False)


def test_a_shape_that_cannot_flow_still_is_an_item(task, monkeypatch):
    def failing(mesh: Mesh, **settings: object) -> None:
        raise DegenerateMesh(f"{mesh.name}: no first step")

    monkeypatch.setattr(augment, "cmcf", failing)
    stage = run(task)
    metrics = stage.finish()
    assert metrics["accepted"] == 0
    assert "no first step" in (task.folder / "flows.csv").read_text()
    kinds = [item.kind for item in training_items(task.folder, augmented=True)]
    assert kinds == ["input"] * 3


def test_a_killed_stage_goes_on_and_ends_the_same(task, tmp_path):
    run(task).finish()
    whole = {path.name: load_npz(path) for path in (task.folder / "meshes").iterdir()}
    (task.folder / "rows" / "ellipsoid.json").unlink()
    (task.folder / "meshes" / "ellipsoid@1.npz").unlink()
    untouched = (task.folder / "meshes" / "bumpy.npz").stat().st_mtime_ns
    run(task).finish()
    again = {path.name: load_npz(path) for path in (task.folder / "meshes").iterdir()}
    assert whole.keys() == again.keys()
    for name, arrays in whole.items():
        for key, value in arrays.items():
            np.testing.assert_array_equal(again[name][key], value)
    assert (task.folder / "meshes" / "bumpy.npz").stat().st_mtime_ns == untouched


def test_the_trainer_runs_the_stage(task):
    stage = AugmentStage(folder=task.folder, skipped=[("open", "open.ply: 3 boundary edges")])
    data = ItemsModule(
        task=task, items=["bumpy", "ellipsoid"], folder=task.folder, workers=Workers(jobs=1)
    )
    trainer = Trainer(accelerator="cpu", logger=False, enable_progress_bar=False)
    trainer.predict(stage, data, return_predictions=False)
    assert stage.finish()["items"] == 2
    assert "3 boundary edges" in (task.folder / "skipped.csv").read_text()
