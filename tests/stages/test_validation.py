"""What is measured during a training, and that the training does not notice."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lightning import Trainer
from lightning.pytorch.loggers import CSVLogger
from test_generator import correspondences, finetune_stage, initialize_stage
from test_implicit import implicit_stage, sdf_module

from gensp.data.clouds import point_cloud
from gensp.data.ground_truth import GroundTruth, save_ground_truth
from gensp.data.shapes import ShapeCollection
from gensp.files import read_rows
from gensp.geometry.mesh import Mesh, normalize, save_mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.sphere import icosphere
from gensp.pictures.curves import loss_curves, read_history
from gensp.stages.validation import DistanceValidation, GeneratorValidation, Validation
from gensp.tasks.generated import KnownShapes

BALL = icosphere(3)


def shapes(root: Path, *splits: str) -> ShapeCollection:
    """Three ellipsoids that are known point by point."""
    axes = {"long": (1.8, 1, 0.8), "flat": (1.2, 1.3, 0.5), "even": (1, 1, 1)}
    corners = np.eye(3)[np.arange(len(BALL.faces)) % 3]
    at = SurfacePoints(np.arange(len(BALL.faces)), corners)
    lines = ["file,split,category,correspondence"]
    for (name, scale), split in zip(axes.items(), splits, strict=True):
        save_mesh(Mesh(BALL.vertices * np.array(scale), BALL.faces), root / f"{name}.ply")
        save_ground_truth(root / f"corr/{name}.npz", GroundTruth("ball", np.arange(1280), at))
        lines.append(f"{name}.ply,{split},ball,corr/{name}.npz")
    (root / "manifest.csv").write_text("\n".join(lines))
    return ShapeCollection.from_folder(root)


def test_exact_images_have_no_error_and_the_distortion_of_their_map(tmp_path: Path) -> None:
    known = KnownShapes(shapes(tmp_path, "val", "val", "val"), ["long", "flat", "even"], level=3)
    images = {id: mesh.vertices for id, mesh in known.meshes.items()}
    figures = known.figures(images)
    assert figures["c"] < 1e-6
    assert figures["coverage"] < 1e-9
    assert figures["bad_faces"] == 0
    assert figures["sigma"] > 1.05
    even = KnownShapes(shapes(tmp_path, "val", "val", "val"), ["even"], level=3)
    alone = even.figures({"even": even.meshes["even"].vertices})
    assert alone["sigma"] == pytest.approx(1, abs=1e-5)
    assert "c" not in alone


def test_turned_images_are_inconsistent_and_collapsed_faces_are_bad(tmp_path: Path) -> None:
    known = KnownShapes(shapes(tmp_path, "val", "val", "val"), ["long", "even"], level=3)
    images = {id: np.array(mesh.vertices) for id, mesh in known.meshes.items()}
    # Half a turn moves the points of the ball, the more the farther from the axis.
    images["even"] = images["even"] * np.array([-1, -1, 1])
    figures = known.figures(images)
    distance = np.linalg.norm(2 * BALL.vertices[:, :2], axis=1).mean()
    scale = np.sqrt(known.meshes["even"].area / (4 * np.pi))
    hausdorff = known.pairs[0].hausdorff
    assert figures["c"] > 0.5 * scale * distance / hausdorff
    assert figures["bad_faces"] == 0
    first = BALL.faces[0]
    images["even"][first] = images["even"][first[0]]
    spoilt = known.figures(images)
    assert spoilt["bad_faces"] > 0
    assert np.isfinite(spoilt["sigma"])


@pytest.mark.parametrize("make", [initialize_stage, finetune_stage])
def test_the_training_of_a_generator_does_not_notice(make: object, tmp_path: Path) -> None:
    collection = shapes(tmp_path / "shapes", "val", "train", "train")
    watch = GeneratorValidation(collection=collection, times=2, level=2)
    blind = trained(make(tmp_path), correspondences(), 4)
    seen = trained(make(tmp_path), correspondences(), 4, watch, tmp_path)
    require_equal(blind, seen)
    rows = [{key for key in row if key.startswith("val/")} for row in seen.history]
    figures = {"val/sigma", "val/bad_faces", "val/coverage"}
    assert rows == [set(), figures, set(), figures]
    logged = read_rows(tmp_path / "logs" / "metrics.csv")
    assert sum(row.get("val/sigma", "") != "" for row in logged) == 2
    assert seen.finish()["val/coverage"] > 0
    # Shapes of the history without a figure leave gaps in the curve, not zeros.
    history = read_history(tmp_path / "history.csv")
    panels = loss_curves({"initialize": history}).axes
    assert {line.get_label() for panel in panels for line in panel.lines} >= {"val coverage"}


def test_the_training_of_the_field_does_not_notice(tmp_path: Path) -> None:
    collection = shapes(tmp_path / "shapes", "val", "train", "train")
    watch = DistanceValidation(collection=collection, times=2, points=60)
    learnt = sdf_module(tmp_path)
    watch.chosen = lambda trainer: [learnt.ids[1]]
    blind = trained(implicit_stage(tmp_path), sdf_module(tmp_path), 2)
    seen = trained(implicit_stage(tmp_path), learnt, 2, watch)
    require_equal(blind, seen)
    assert 0 < seen.history[-1]["val/distance"] < 2


def test_the_field_is_measured_without_reading_other_shapes(tmp_path: Path) -> None:
    asked = []

    class Watched(list[Mesh]):
        def __getitem__(self, place: int) -> Mesh:
            asked.append(place)
            return super().__getitem__(place)

        def __iter__(self) -> None:
            raise AssertionError("all are read")

    watch = DistanceValidation(collection=shapes(tmp_path / "shapes", *3 * ["val"]), points=60)
    data = sdf_module(tmp_path)
    _ = data.bound
    data.meshes = Watched(data.meshes)
    watch._drawn(SimpleNamespace(datamodule=data), data.ids[2:3])
    assert asked == [1]


@pytest.mark.parametrize("make", [GeneratorValidation, DistanceValidation])
def test_shapes_that_are_not_learnt_from_are_measured_from_the_collection(
    make: type[Validation], tmp_path: Path
) -> None:
    collection = shapes(tmp_path / "shapes", "train", "train", "val")
    watch = make(collection=collection, times=1)
    stage, data = initialize_stage(tmp_path), correspondences()
    if make is DistanceValidation:
        stage, data = implicit_stage(tmp_path), sdf_module(tmp_path)
    assert "even" not in data.ids
    seen = trained(stage, data, 1, watch)
    assert watch.chosen(seen.trainer) == ["even"]
    figures = [value for name, value in seen.history[-1].items() if name.startswith("val/")]
    assert len(figures) >= 1
    assert np.isfinite(figures).all()


def test_a_code_of_validation_is_that_of_the_cloud_that_maps_are_made_from(tmp_path: Path) -> None:
    collection = shapes(tmp_path / "shapes", "train", "train", "val")
    stage, data = initialize_stage(tmp_path), correspondences()
    watch = GeneratorValidation(collection=collection, times=1)
    seen = trained(stage, data, 1, watch)
    (code,) = watch.codes(seen.trainer, seen, ["even"])
    cloud = point_cloud(normalize(collection.mesh("even")), data.batching.cloud)
    ball = data.clouds[:1, 0]
    clouds = torch.cat([ball, torch.from_numpy(cloud)[None]])
    origin, found = seen.encoder(clouds) + seen.encoder.origin
    assert torch.allclose(code, found - origin, atol=1e-5)


def test_training_shapes_stand_in_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    watch = GeneratorValidation(collection=shapes(tmp_path, "train", "train", "test"), shapes=1)
    trained(initialize_stage(tmp_path), correspondences(), 1, watch)
    assert "no shape of split val: val/ is measured on long, of train" in capsys.readouterr().out


@pytest.mark.parametrize(("epochs", "times", "ends"), [(6, 2, [3, 6]), (2, 5, [1, 2]), (3, 0, [])])
def test_when_it_measures(epochs: int, times: int, ends: list[int]) -> None:
    watch = Validation(collection=None, times=times)
    trainer = Trainer(max_epochs=epochs, logger=False, enable_checkpointing=False)
    found = []
    for done in range(1, epochs + 1):
        trainer.fit_loop.epoch_progress.current.completed = done - 1
        trainer.fit_loop.epoch_progress.current.processed = done - 1
        if watch._due(trainer):
            found.append(done)
    assert found == ends


def trained(
    stage: object, data: object, epochs: int, watch: Validation | None = None, logs: object = None
) -> object:
    trainer = Trainer(
        max_epochs=epochs,
        accelerator="cpu",
        logger=CSVLogger(logs, name="logs", version="") if logs else False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        inference_mode=False,
        callbacks=[watch] if watch else [],
    )
    trainer.fit(stage, data)
    return stage


def require_equal(blind: object, seen: object) -> None:
    state = blind.state_dict()
    assert all(torch.equal(value, state[key]) for key, value in seen.state_dict().items())
    for row, other in zip(blind.history, seen.history, strict=True):
        assert row == {key: value for key, value in other.items() if not key.startswith("val/")}
