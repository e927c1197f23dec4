from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lightning import Trainer, seed_everything
from lightning.pytorch.callbacks import ModelCheckpoint

from gensp.data.fitting import Batching
from gensp.data.training import CorrespondenceModule
from gensp.files import load_npz, save_npz, write_json
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.distortion import distortion
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.predicates import bad_faces
from gensp.geometry.sphere import icosphere
from gensp.models import (
    AnchoredGenerator,
    DirectGenerator,
    FlowGenerator,
    Generator,
    PointNet2Encoder,
    load_model,
    save_model,
)
from gensp.runs import Run
from gensp.stages.generator import FinetuneStage, GeneratorStage, InitializeStage

FINETUNE = {
    "train_encoder": True,
    "deformation_weight": 0.01,
    "isometry_weight": 0.01,
    "geometric_regularization": True,
    "deformation_codes": 2,
    "deformation_points": 16,
    "correspondence_weight": 1.0,
    "final_correspondence_weight": 0.1,
    "coverage_weight": 1.0,
    "level": 2,
    "learning_rate": 1e-3,
}


def ellipsoids() -> list[Mesh]:
    ball = icosphere(3)
    axes = {"long": (1.8, 1, 0.8), "flat": (1.2, 1.3, 0.5), "long@0": (1.3, 1, 0.9)}
    return [
        normalize(Mesh(ball.vertices * np.array(scale), ball.faces, name))
        for name, scale in axes.items()
    ]


def correspondences(passes: int = 1, unknown: int = 30) -> CorrespondenceModule:
    meshes = ellipsoids()
    targets = np.stack([mesh.vertices for mesh in meshes])
    valid = np.ones(targets.shape[:2], dtype=bool)
    valid[:, :unknown] = False
    targets[:, :unknown] = np.nan
    batching = Batching(size=4, points=128, surface_points=64, passes=passes, cloud=128)
    return CorrespondenceModule(meshes, targets, valid, batching=batching)


def encoder() -> PointNet2Encoder:
    seed_everything(0, verbose=False)
    return PointNet2Encoder(8, width=8, groups=((32, 8), (8, 4)))


def generator(form: str = "linear") -> Generator:
    seed_everything(1, verbose=False)
    small = {"width": 48, "depth": 3, "inject": ()}
    if form == "direct":
        return DirectGenerator(8, **small)
    if form == "flow":
        return FlowGenerator(8, rank=4, steps=2, **small)
    return AnchoredGenerator(8, form=form, rank=4, **small)


def initialize_stage(folder: Path, form: str = "linear") -> InitializeStage:
    return InitializeStage(
        encoder=encoder(),
        generator=generator(form),
        latent_spread=2.0,
        learning_rate=5e-3,
        folder=folder,
    )


def finetune_stage(folder: Path, **changes: object) -> FinetuneStage:
    surfaces = {mesh.name: ClosestPointTree(mesh) for mesh in [*ellipsoids(), icosphere(4)]}
    parents = {"long@0": "sphere", "long": "long@0", "flat": "sphere"}
    fixed = {"encoder": encoder(), "generator": generator(), "folder": folder}
    return FinetuneStage(surfaces=surfaces, parents=parents, **fixed, **{**FINETUNE, **changes})


def fit(
    stage: GeneratorStage, data: CorrespondenceModule, epochs: int, **more: object
) -> GeneratorStage:
    callbacks = list(more.pop("callbacks", ()))
    trainer = Trainer(
        accumulate_grad_batches=more.pop("accumulate_grad_batches", 1),
        max_epochs=epochs,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=bool(callbacks),
        enable_progress_bar=False,
        enable_model_summary=False,
        inference_mode=False,
        callbacks=callbacks,
    )
    trainer.fit(stage, data, **more)
    return stage


@pytest.mark.parametrize("form", ["direct", "blend", "difference", "linear", "flow"])
def test_correspondences_of_ellipsoids_are_learnt(tmp_path: Path, form: str) -> None:
    stage = fit(initialize_stage(tmp_path, form), correspondences(passes=15), 8)
    losses = [row["train/correspondence"] for row in stage.history]
    assert losses[-1] < losses[0] / 10


@pytest.mark.parametrize("make", [initialize_stage, finetune_stage])
@pytest.mark.parametrize("micro", [2, 3, 4])
def test_accumulated_gradients_are_those_of_one_batch(
    tmp_path: Path, make: Callable[..., GeneratorStage], micro: int
) -> None:
    def gradients(size: int, micro: int) -> list[torch.Tensor]:
        stage, data, found = make(tmp_path), correspondences(), []
        data.batching = replace(data.batching, size=size)
        stage.on_before_optimizer_step = lambda optimizer: found.extend(
            weight.grad.clone() for weight in stage.parameters() if weight.grad is not None
        )
        fit(stage, data, 1, accumulate_grad_batches=micro)
        assert stage.trainer.global_step == 1
        return found

    # Three shapes and S_0 in one batch: of size 4, or of enough parts that hold 4 together.
    expected = gradients(12, 1)
    for one, other in zip(gradients(12 // micro, micro), expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


def test_maps_are_placed_where_all_shapes_are_distorted_least(tmp_path: Path) -> None:
    stage = initialize_stage(tmp_path)
    stage.placement = {"energy": "sigma", "floor": 1.0}
    fit(stage, correspondences(unknown=0), 1).finish()
    atlas = load_model(tmp_path / "model.pt")["atlas"]
    sphere, placed = atlas.sphere.double().numpy(), atlas.placed.double().numpy()
    faces = atlas.triangles.numpy().astype(np.int64)

    def sigma(at: np.ndarray) -> float:
        images = atlas.images.double().numpy()
        return float(np.mean([distortion(image, at, faces).mean for image in images]))

    assert sigma(placed) < sigma(sphere) - 0.01
    assert not bad_faces(placed, faces).any()
    np.testing.assert_allclose(atlas.place(sphere), placed, atol=1e-6)


def test_initialize_leaves_its_encoder_as_it_was_and_scales_codes(tmp_path: Path) -> None:
    data = correspondences()
    stage = fit(initialize_stage(tmp_path), data, 1)
    before, after = encoder().state_dict(), stage.encoder.state_dict()
    assert all(torch.equal(value, before[key]) for key, value in after.items())
    inputs = stage.generator.scaled(stage.table.of(["long", "flat"]))
    spread = (inputs - inputs.mean(0)).square().sum(1).mean().sqrt()
    assert spread.item() == pytest.approx(2, rel=1e-4)
    stage.finish()
    networks = load_model(tmp_path / "model.pt")
    known = np.mean([mesh.vertices[30:] for mesh in ellipsoids()[:2]], axis=0)
    sphere = icosphere(3).vertices[:30]
    mean = np.concatenate([sphere, known])
    np.testing.assert_allclose(networks["generator"].mean_image, mean, atol=1e-6)
    inputs = load_npz(tmp_path / "latents.npz")["codes"][1:3]
    np.testing.assert_allclose(networks["generator"].mean_code, inputs.mean(axis=0), atol=1e-6)
    codes = load_npz(tmp_path / "latents.npz")["codes"]
    np.testing.assert_allclose(networks["encoder"](data.clouds[:, 0]).detach(), codes, atol=1e-5)
    z, p = torch.from_numpy(codes[1:2]), torch.tensor(icosphere(1).vertices).float()[None]
    torch.testing.assert_close(networks["generator"](z, p), stage.generator(z, p))


def test_finetune_logs_every_loss_and_moves_both_networks(tmp_path: Path) -> None:
    stage = fit(finetune_stage(tmp_path), correspondences(passes=10), 6)
    assert {"train/data", "train/coverage", "train/correspondence", "train/deformation"} <= set(
        stage.history[-1]
    )
    assert stage.history[-1]["train/data"] < stage.history[0]["train/data"] / 2
    assert not torch.equal(stage.encoder.head[1].weight, encoder().head[1].weight)
    headline = stage.finish()
    assert next(iter(headline)) == "train/data"
    zero = load_npz(tmp_path / "latents.npz")["codes"][0]
    assert (zero == 0).all()


def test_switches_of_finetune(tmp_path: Path) -> None:
    changes = {
        "geometric_regularization": False,
        "train_encoder": False,
        "coverage_weight": 0.0,
        "correspondence_weight": 0.0,
        "final_correspondence_weight": 0.0,
    }
    stage = fit(finetune_stage(tmp_path, **changes), correspondences(), 1)
    assert "train/deformation" not in stage.history[0]
    assert stage.history[0]["train/coverage"] > 0
    assert all(map(torch.equal, stage.encoder.parameters(), encoder().parameters()))


def test_coverage_term_lowers_coverage(tmp_path: Path) -> None:
    ends = []
    for weight in (0.0, 5.0):
        changes = {"coverage_weight": weight, "correspondence_weight": 0.0}
        stage = finetune_stage(tmp_path, **changes, deformation_weight=1.0)
        ends.append(fit(stage, correspondences(passes=4), 5).history[-1]["train/coverage"])
    assert ends[1] < ends[0]


@pytest.mark.parametrize("make", [initialize_stage, finetune_stage])
def test_resumed_training_equals_uninterrupted(make: object, tmp_path: Path) -> None:
    keep = ModelCheckpoint(dirpath=tmp_path, filename="{epoch}", save_top_k=-1)
    whole = fit(make(tmp_path), correspondences(), 4, callbacks=[keep])
    resumed = fit(make(tmp_path), correspondences(), 4, ckpt_path=tmp_path / "epoch=1.ckpt")
    assert resumed.history == whole.history
    state = whole.state_dict()
    assert all(torch.equal(value, state[key]) for key, value in resumed.state_dict().items())


def test_turned_ball_is_a_rotation(tmp_path: Path) -> None:
    stage = finetune_stage(tmp_path)
    random = torch.Generator().manual_seed(5)
    for _ in range(5):
        turned = stage._turned_ball(random).numpy()
        rotation = np.linalg.lstsq(stage.ball.vertices, turned, rcond=None)[0]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_stages_find_what_the_stages_before_left(tmp_path: Path) -> None:
    names = ("augment", "implicit", "correspond", "initialize")
    runs = {name: Run(tmp_path / name) for name in names}
    save_model(runs["implicit"].folder / "model.pt", encoder=encoder())
    fixed = {"latent_spread": 2.0, "learning_rate": 1e-3}
    first = InitializeStage.from_runs(
        runs, runs["initialize"].folder, generator=generator(), **fixed
    )
    fit(first, correspondences(), 1).finish()
    for mesh in ellipsoids():
        path = runs["augment"].folder / "meshes" / f"{mesh.name}.npz"
        save_npz(path, vertices=mesh.vertices, faces=mesh.faces)
    tree = {"ids": ["sphere", "long@0", "long", "flat@3", "flat"], "parent": [-1, 0, 1, 0, 3]}
    write_json(runs["correspond"].folder / "tree.json", tree)
    second = FinetuneStage.from_runs(runs, tmp_path / "finetune", **FINETUNE)
    stage = fit(second, correspondences(), 1)
    assert {id: int(stage.table.parent[row]) for id, row in stage.table.rows.items()} == {
        "sphere": -1,
        "long": stage.table.rows["long@0"],
        "flat": 0,
        "long@0": 0,
    }
