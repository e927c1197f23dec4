from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from lightning import Trainer

from gensp.compute import run_items, stored_rows
from gensp.data.modules import ItemsModule
from gensp.data.shapes import ShapeCollection
from gensp.errors import GenSPError, NotEmbeddable
from gensp.files import load_npz
from gensp.geometry.mesh import load_mesh, save_mesh
from gensp.geometry.spherical_map import load_map
from gensp.methods.cmcf import CMCF
from gensp.methods.refinement import NewtonRefinement, NoRefinement
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.parameterize import ParameterizeStage
from gensp.tasks.parameterize import Parameterize, parameterize_items, parameterize_task


@pytest.fixture
def collection(tmp_path, bumpy, ellipsoid):
    for mesh in (bumpy, ellipsoid):
        save_mesh(mesh, tmp_path / "shapes" / f"{mesh.name}.ply")
    return ShapeCollection.from_folder(tmp_path / "shapes")


def make_task(collection, folder, refine=None):
    method = partial(CMCF, refine or NewtonRefinement(max_iterations=5))
    return parameterize_task(inputs={}, folder=folder, collection=collection, method=method)


class PredictingMethod:
    """Stands for a method with trained networks: it keeps a prediction beside its map."""

    name = "predicting"

    def __init__(self, path):
        self.path = path

    def __call__(self, mesh):
        map = CMCF(NoRefinement())(mesh)
        return replace(map, arrays={"code": np.arange(3.0), "predicted": map.sphere})


class FailingMethod:
    """A method that can map no shape."""

    name = "failing"

    def __call__(self, mesh):
        raise NotEmbeddable(f"{mesh.name}: nothing works")


def test_maps_are_written_in_the_inputs_order(collection, tmp_path):
    folder = tmp_path / "out"
    task = make_task(collection, folder)
    rows = list(run_items(task, collection.ids(), folder, Workers(jobs=1)))
    assert sorted(row["id"] for row in rows) == ["bumpy", "ellipsoid"]
    for row in rows:
        map = load_map(folder / "maps" / f"{row['id']}.npz")
        original = load_mesh(collection.shape(row["id"]).path)
        np.testing.assert_array_equal(map.surface, original.vertices)
        np.testing.assert_array_equal(map.faces, original.faces)
        assert (folder / "maps" / f"{row['id']}.ply").is_file()
        assert row["bad_faces"] == map.bad_faces().sum() == 0
        assert row["degree"] == 1
        assert row["seconds"] > 0
    assert not (folder / "predictions").exists()


def test_predictions_are_kept_and_networks_handed_over(collection, tmp_path):
    trained = Run(tmp_path / "finetune")
    task = parameterize_task(
        inputs={"finetune": trained},
        folder=tmp_path / "out",
        collection=collection,
        method=PredictingMethod,
    )
    assert task.make().path == trained.folder / "model.pt"
    task("bumpy")
    kept = load_npz(tmp_path / "out" / "predictions" / "bumpy.npz")
    np.testing.assert_array_equal(kept["code"], [0, 1, 2])
    assert (
        kept["predicted"].shape == load_map(tmp_path / "out" / "maps" / "bumpy.npz").sphere.shape
    )


def test_workers_and_one_process_agree_bitwise(collection, tmp_path):
    spheres = []
    for jobs in (1, 2):
        folder = tmp_path / f"jobs{jobs}"
        list(run_items(make_task(collection, folder), collection.ids(), folder, Workers(jobs)))
        spheres.append(load_map(folder / "maps" / "bumpy.npz").sphere)
    np.testing.assert_array_equal(*spheres)


def test_stage_predicts_writes_its_table_and_resumes(collection, tmp_path):
    folder = tmp_path / "out"
    module = ItemsModule.from_runs(
        {},
        folder,
        task=partial(
            parameterize_task,
            collection=collection,
            method=partial(CMCF, NewtonRefinement(max_iterations=5)),
        ),
        items=partial(parameterize_items, collection=collection),
        workers=Workers(jobs=1),
    )
    stage = ParameterizeStage.from_runs({}, folder)
    trainer = Trainer(
        accelerator="cpu", logger=False, enable_progress_bar=False, enable_checkpointing=False
    )
    trainer.predict(stage, datamodule=module, return_predictions=False)
    metrics = stage.finish()
    assert next(iter(metrics)) == "bad_faces"
    assert metrics["bad_faces"] == metrics["folded_maps"] == metrics["failed"] == 0
    assert metrics["items"] == 2
    assert metrics["seconds_per_shape"] > 0
    assert "seconds" not in metrics
    table = (folder / "maps.csv").read_text().splitlines()
    assert len(table) == 3
    assert {"id", "seconds", "rung", "bad_faces_start", "bad_faces"} <= set(table[0].split(","))
    # Again: finished shapes are kept, not mapped anew.
    written = (folder / "maps" / "bumpy.npz").stat().st_mtime_ns
    list(run_items(make_task(collection, folder), collection.ids(), folder, Workers(jobs=1)))
    assert (folder / "maps" / "bumpy.npz").stat().st_mtime_ns == written


def test_failed_shapes_are_reported(collection, tmp_path):
    folder = tmp_path / "out"
    task = Parameterize(collection, FailingMethod, folder)
    list(run_items(task, collection.ids(), folder, Workers(jobs=1)))
    assert all("nothing works" in row["error"] for row in stored_rows(folder))
    with pytest.raises(GenSPError, match="2 of 2 items failed"):
        ParameterizeStage(folder=folder).finish()
    assert ParameterizeStage(folder=folder, max_failures=2).finish()["failed"] == 2
