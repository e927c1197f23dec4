from pathlib import Path

import numpy as np
import pytest
import torch
from lightning import Callback, Trainer, seed_everything
from lightning.pytorch.callbacks import ModelCheckpoint

from gensp.data.fitting import Batching
from gensp.data.sdf import SdfSampler
from gensp.data.training import SdfModule
from gensp.files import load_npz
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.models import ImplicitField, PointNet2Encoder, load_model
from gensp.sharing import Workers
from gensp.stages import latents
from gensp.stages.implicit import ImplicitStage, LevelSetSampling


def ellipsoids(count: int = 2) -> list[Mesh]:
    ball = icosphere(3)
    stretch = np.linspace(1.3, 2.0, count)
    return [
        normalize(Mesh(ball.vertices * np.array([s, 1, 1 / s]), ball.faces, f"ellipsoid{k}"))
        for k, s in enumerate(stretch)
    ]


def sdf_module(cache: Path, count: int = 2, passes: int = 1) -> SdfModule:
    return SdfModule(
        ellipsoids(count),
        batching=Batching(size=3, points=256, passes=passes, cloud=128),
        sampler=SdfSampler(near=400, far=200, uniform=200),
        cache=cache,
        workers=Workers(jobs=1, backend="sequential"),
    )


def implicit_stage(folder: Path, **changes: object) -> ImplicitStage:
    seed_everything(0, verbose=False)
    settings = {
        "encoder": PointNet2Encoder(8, width=8, groups=((32, 8), (8, 4))),
        "field": ImplicitField(8, width=32, depth=3, inject=(2,)),
        "norm": "l1",
        "tolerance": 0.0,
        "encoder_weight": 1e-3,
        "penalize": "latents",
        "origin_weight": 0.1,
        "deformation_weight": 0.01,
        "geometric_regularization": True,
        "regularize_from_epoch": 1,
        "sampling": LevelSetSampling(
            vertices=150, nodes=15, directions=2, resolution=24, kept=2, every=3
        ),
        "learning_rate": 5e-3,
        "folder": folder,
    }
    return ImplicitStage(**{**settings, **changes})


def trainer(epochs: int, *callbacks: Callback) -> Trainer:
    return Trainer(
        max_epochs=epochs,
        accelerator="cpu",
        logger=False,
        # Without a callback that says where, Lightning keeps checkpoints in the working folder.
        enable_checkpointing=any(isinstance(each, ModelCheckpoint) for each in callbacks),
        enable_progress_bar=False,
        enable_model_summary=False,
        inference_mode=False,
        callbacks=list(callbacks),
    )


def fit(stage: ImplicitStage, data: SdfModule, epochs: int, **more: object) -> ImplicitStage:
    trainer(epochs, *more.pop("callbacks", ())).fit(stage, data, **more)
    return stage


def test_two_ellipsoids_are_learnt(tmp_path: Path) -> None:
    stage = implicit_stage(tmp_path, geometric_regularization=False, learning_rate=1e-2)
    fit(stage, sdf_module(tmp_path, passes=10), 35)
    assert stage.history[-1]["train/data"] < stage.history[0]["train/data"] / 8
    assert "train/deformation" not in stage.history[-1]
    final = stage.finish()
    assert next(iter(final)) == "train/data"


def test_stage_leaves_networks_codes_and_history(tmp_path: Path) -> None:
    data = sdf_module(tmp_path)
    stage = fit(implicit_stage(tmp_path), data, 3)
    assert np.isfinite(stage.history[-1]["train/deformation"])
    assert "train/deformation" not in stage.history[0]
    assert stage.history[-1]["train/level_set_share"] == 1
    stage.finish()
    stored = load_npz(tmp_path / "latents.npz")
    assert stored["ids"].tolist() == ["sphere", "ellipsoid0", "ellipsoid1"]
    assert (stored["codes"][0] == 0).all()
    networks = load_model(tmp_path / "model.pt")
    assert networks.keys() == {"encoder", "field"}
    assert networks["encoder"].settings["points"] == 128
    assert networks["encoder"].settings["draws"] == 1
    codes = networks["encoder"](data.clouds[:, 0]).detach().numpy()
    np.testing.assert_allclose(codes, stored["codes"], atol=1e-5)
    assert (tmp_path / "history.csv").read_text().count("\n") == 4


def test_resumed_training_equals_uninterrupted(tmp_path: Path) -> None:
    data = sdf_module(tmp_path, passes=2)
    keep = ModelCheckpoint(dirpath=tmp_path, filename="{epoch}", save_top_k=-1)
    whole = fit(implicit_stage(tmp_path), data, 4, callbacks=[keep])
    path = tmp_path / "epoch=1.ckpt"
    data = sdf_module(tmp_path, passes=2)
    resumed = fit(implicit_stage(tmp_path), data, 4, ckpt_path=path)
    assert resumed.history == whole.history
    state = whole.state_dict()
    assert all(torch.equal(value, state[key]) for key, value in resumed.state_dict().items())


def test_a_tree_of_many_items_is_spanned_anew_where_it_would_have_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Three steps renew all six; the checkpoint lies between two trees.
    monkeypatch.setattr(latents, "ALL_PAIRS", 3)
    keep = ModelCheckpoint(dirpath=tmp_path, filename="{epoch}", save_top_k=-1)
    whole = fit(implicit_stage(tmp_path), sdf_module(tmp_path, 6), 3, callbacks=[keep])
    path = tmp_path / "epoch=1.ckpt"
    resumed = fit(implicit_stage(tmp_path), sdf_module(tmp_path, 6), 3, ckpt_path=path)
    assert torch.load(path, weights_only=True)["renewed"] == 4
    assert resumed.history == whole.history
    assert torch.equal(resumed.table.parent, whole.table.parent)


@pytest.mark.parametrize("penalize", ["latents", "weights"])
def test_origin_is_held(tmp_path: Path, penalize: str) -> None:
    data = sdf_module(tmp_path, passes=10)
    free = fit(implicit_stage(tmp_path, origin_weight=0.0, penalize=penalize), data, 2)
    held = fit(implicit_stage(tmp_path, origin_weight=10.0, penalize=penalize), data, 2)
    assert held.history[-1]["train/origin"] < free.history[-1]["train/origin"] / 2


def test_regulariser_lowers_the_deformation_between_shapes(tmp_path: Path) -> None:
    data = sdf_module(tmp_path, passes=10)
    ratios = []
    for weight in (0.0, 1.0):
        stage = implicit_stage(tmp_path, deformation_weight=weight)
        ratios.append(fit(stage, data, 4).history[-1]["train/deformation"])
    assert ratios[1] < ratios[0]


def test_level_set_that_does_not_exist_yet_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stage = implicit_stage(tmp_path, regularize_from_epoch=0)
    with torch.no_grad():
        stage.field.trunk.last.bias.fill_(50.0)
    fit(stage, sdf_module(tmp_path), 1)
    assert "train/deformation" not in stage.history[0]
    assert np.isfinite(stage.history[0]["train/data"])
    assert stage.history[0]["train/level_set_share"] == 0
    stage.finish()
    assert "warning" in (said := capsys.readouterr().out)
    assert "never took part" in " ".join(said.split())


def test_tolerance_falls_to_zero_at_half_of_the_epochs(tmp_path: Path) -> None:
    stage = implicit_stage(tmp_path, tolerance=0.02)
    seen = []

    class Noted(Callback):
        def on_train_epoch_start(self, trainer: Trainer, stage: ImplicitStage) -> None:
            seen.append(stage._tolerance())

    fit(stage, sdf_module(tmp_path), 4, callbacks=[Noted()])
    assert seen == pytest.approx([0.02, 0.01, 0, 0])
