"""Batches: S_0 first, reproducible by (seed, epoch), shared out over ranks."""

from pathlib import Path

import numpy as np
import pytest
import torch
from lightning import LightningModule, Trainer

from gensp.data.batches import CorrespondenceBatch, SdfBatch
from gensp.data.fitting import Batching
from gensp.data.loading import epoch_loader
from gensp.data.sdf import SdfSampler
from gensp.data.training import CorrespondenceModule, SdfModule
from gensp.errors import MissingData
from gensp.files import save_npz, write_json
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.runs import Run
from gensp.sharing import Workers


@pytest.fixture
def meshes(bumpy: Mesh, ellipsoid: Mesh, dumbbell: Mesh) -> list[Mesh]:
    return [normalize(mesh) for mesh in (bumpy, ellipsoid, dumbbell)]


@pytest.fixture
def sdf(meshes: list[Mesh], tmp_path: Path) -> SdfModule:
    return SdfModule(
        meshes,
        batching=Batching(size=3, points=64, cloud=128),
        sampler=SdfSampler(near=100, far=100, uniform=100),
        cache=tmp_path,
        seed=5,
        workers=Workers(jobs=1, backend="sequential"),
    )


@pytest.fixture
def carried(meshes: list[Mesh]) -> CorrespondenceModule:
    targets = np.stack([mesh.vertices for mesh in meshes])
    valid = np.ones(targets.shape[:2], dtype=bool)
    valid[1, 10:20] = False
    batching = Batching(size=4, points=50, surface_points=20, cloud=128)
    return CorrespondenceModule(meshes, targets, valid, batching=batching, seed=5)


def epoch_of(module: SdfModule | CorrespondenceModule, epoch: int) -> list:
    loader = module.train_dataloader()
    loader.sampler.set_epoch(epoch)
    return list(loader)


def test_every_batch_opens_with_the_sphere_and_an_epoch_has_all_items(sdf: SdfModule) -> None:
    batches: list[SdfBatch] = epoch_of(sdf, 0)
    assert [len(batch.ids) for batch in batches] == [3, 2]
    assert all(batch.ids[0] == "sphere" for batch in batches)
    seen = [id for batch in batches for id in batch.ids[1:]]
    assert sorted(seen) == ["bumpy", "dumbbell", "ellipsoid"]
    assert sdf.ids == ["sphere", "bumpy", "ellipsoid", "dumbbell"]


def test_sdf_batches_hold_each_items_own_samples(sdf: SdfModule) -> None:
    for batch in epoch_of(sdf, 3):
        assert batch.points.shape == (len(batch.ids), 64, 3)
        assert batch.points.dtype == batch.distances.dtype == torch.float32
        assert torch.allclose(batch.points[0].norm(dim=1) - 1, batch.distances[0], atol=1e-6)
        for row, id in enumerate(batch.ids):
            drawn, draw = batch.drawn[row]
            assert drawn == id
            assert (batch.clouds[row] == sdf.clouds[sdf.ids.index(id), draw]).all()


def test_draws_depend_on_seed_and_epoch_alone(sdf: SdfModule) -> None:
    first = epoch_of(sdf, 2)
    torch.manual_seed(123)
    epoch_of(sdf, 7)
    for one, other in zip(first, epoch_of(sdf, 2), strict=True):
        assert one.ids == other.ids
        assert (one.points == other.points).all()
    later = epoch_of(sdf, 3)
    assert not any(
        one.points.shape == other.points.shape and (one.points == other.points).all()
        for one, other in zip(first, later, strict=True)
    )


PARTS = [(1, 1), (2, 1), (3, 1), (1, 2), (1, 4), (2, 2), (2, 3)]


def parts_of(module: SdfModule | CorrespondenceModule, ranks: int, micro: int) -> list[list]:
    """For every step all of its parts, over the ranks and over the micro-batches."""
    loaded = [
        list(epoch_loader(module.dataset(), batch_size=3, micro=micro, rank=rank, ranks=ranks))
        for rank in range(ranks)
    ]
    assert len({len(batches) for batches in loaded}) == 1
    assert len(loaded[0]) % micro == 0, "every step has all of its micro-batches"
    for batches in loaded:
        assert [batch.ends for batch in batches] == [
            (k + 1) % micro == 0 for k in range(len(batches))
        ]
    steps = range(0, len(loaded[0]), micro)
    return [[batch for batches in loaded for batch in batches[k : k + micro]] for k in steps]


@pytest.mark.parametrize(("ranks", "micro"), PARTS)
def test_ranks_and_micro_batches_share_out_one_batch(
    sdf: SdfModule, ranks: int, micro: int
) -> None:
    whole = list(epoch_loader(sdf.dataset(), batch_size=3))
    for batch, shares in zip(whole, parts_of(sdf, ranks, micro), strict=True):
        ids = [id for share in shares for id in share.ids[1:]]
        assert sorted(ids) == sorted(batch.ids[1:])
        # S_0 shows every part the same cloud and the same samples.
        assert all(torch.equal(share.points[0], batch.points[0]) for share in shares)
        assert all(share.drawn[0] == batch.drawn[0] for share in shares)
        means = [share.weight * share.distances[share.first :].mean() for share in shares]
        expected = batch.distances.mean()
        torch.testing.assert_close(torch.stack(means).mean(), expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(("ranks", "micro"), PARTS)
def test_known_targets_weigh_alike_in_every_part(
    carried: CorrespondenceModule, ranks: int, micro: int
) -> None:
    def mean(batch: CorrespondenceBatch) -> torch.Tensor:
        valid = batch.valid[batch.first :]
        return batch.targets[batch.first :][valid].square().sum() / valid.sum()

    whole = list(epoch_loader(carried.dataset(), batch_size=3))
    for batch, shares in zip(whole, parts_of(carried, ranks, micro), strict=True):
        means = [share.known_weight * mean(share) for share in shares]
        torch.testing.assert_close(torch.stack(means).mean(), mean(batch), rtol=1e-5, atol=1e-7)


def test_the_first_batches_can_be_repeated(sdf: SdfModule) -> None:
    """As debug=overfit does, which asks by number instead of by the sampler."""
    dataset = sdf.dataset()
    epoch_loader(dataset, batch_size=3, micro=2)
    assert len(dataset) == 4
    ids = [dataset[k].ids for k in range(len(dataset))]
    assert ids == [
        ["sphere", "bumpy"],
        ["sphere", "ellipsoid"],
        ["sphere", "dumbbell"],
        ["sphere"],
    ]


def test_passes_lengthen_the_epoch(sdf: SdfModule) -> None:
    sdf.batching = Batching(size=4, points=64, passes=5, cloud=128)
    batches = epoch_of(sdf, 0)
    assert len(batches) == 5
    seen = [id for batch in batches for id in batch.ids[1:]]
    assert sorted(seen) == sorted(5 * sdf.ids[1:])


class Recorder(LightningModule):
    """Trains nothing and notes what each epoch was shown."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))
        self.seen: dict[int, list] = {}

    def training_step(self, batch: SdfBatch, index: int) -> torch.Tensor:
        self.seen.setdefault(self.current_epoch, []).append((batch.ids, batch.points.sum().item()))
        return self.weight.sum()

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=0.1)


def test_trainer_shows_a_resumed_run_the_same_batches(sdf: SdfModule, tmp_path: Path) -> None:
    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False}

    def trainer(epochs: int) -> Trainer:
        return Trainer(max_epochs=epochs, accelerator="cpu", enable_checkpointing=False, **quiet)

    whole, first, rest = Recorder(), Recorder(), Recorder()
    trainer(3).fit(whole, datamodule=sdf)
    half = trainer(2)
    half.fit(first, datamodule=sdf)
    half.save_checkpoint(tmp_path / "last.ckpt")
    trainer(3).fit(rest, datamodule=sdf, ckpt_path=tmp_path / "last.ckpt")
    assert {**first.seen, **rest.seen} == whole.seen
    assert whole.seen[0] != whole.seen[1] != whole.seen[2]


def test_bound_holds_all_shapes(sdf: SdfModule, meshes: list[Mesh]) -> None:
    assert sdf.bound > max(np.abs(mesh.vertices).max() for mesh in meshes)
    assert sdf.bound < 1.25 * max(np.abs(mesh.vertices).max() for mesh in meshes)


def test_prepared_cache_is_used(sdf: SdfModule) -> None:
    sdf.prepare_data()
    files = sorted(sdf.cache.glob("*/*.npz"))
    assert len(files) == 3
    before = [file.stat().st_mtime_ns for file in files]
    epoch_of(sdf, 0)
    assert [file.stat().st_mtime_ns for file in files] == before


def test_correspondence_batches_pair_vertices_with_their_places(
    carried: CorrespondenceModule, meshes: list[Mesh]
) -> None:
    (batch,) = epoch_of(carried, 0)
    assert isinstance(batch, CorrespondenceBatch)
    ball = icosphere(3).vertices.astype(np.float32)
    for row, id in enumerate(batch.ids):
        drawn = [
            int(np.flatnonzero((ball == p).all(axis=1))[0]) for p in batch.sphere[row].numpy()
        ]
        assert len(set(drawn)) == 50
        places = ball if id == "sphere" else meshes[carried.ids.index(id) - 1].vertices
        assert np.allclose(batch.targets[row], places[drawn], atol=1e-6)
        known = [not (id == "ellipsoid" and 10 <= vertex < 20) for vertex in drawn]
        assert batch.valid[row].tolist() == known
    assert batch.surface.shape == (4, 20, 3)
    assert batch.ids[0] == "sphere"
    assert (batch.surface[0].norm(dim=1) > 0.99).all()


def test_correspondence_draws_are_reproducible(carried: CorrespondenceModule) -> None:
    (one,), (other,), (later,) = (epoch_of(carried, epoch) for epoch in (4, 4, 5))
    assert one.ids == other.ids
    assert (one.sphere == other.sphere).all()
    assert (one.surface == other.surface).all()
    assert not (one.sphere == later.sphere).all()


@pytest.fixture
def runs(tmp_path: Path, meshes: list[Mesh]) -> dict[str, Run]:
    augment, correspond = tmp_path / "augment", tmp_path / "correspond"
    items = []
    for mesh, kind in zip(meshes, ("input", "input", "augmented"), strict=True):
        save_npz(augment / "meshes" / f"{mesh.name}.npz", vertices=mesh.vertices, faces=mesh.faces)
        items.append(
            {"id": mesh.name, "shape": mesh.name, "split": "train", "kind": kind, "t": 0.0}
        )
        save_npz(
            correspond / "correspondences" / f"{mesh.name}.npz",
            points=mesh.vertices,
            valid=np.ones(len(mesh.vertices), dtype=bool),
        )
    write_json(augment / "items.json", items)
    return {"augment": Run(augment), "correspond": Run(correspond)}


def test_modules_read_what_the_stages_left(runs: dict[str, Run], tmp_path: Path) -> None:
    batching = Batching(size=4, points=32, cloud=64)
    settings = {"batching": batching, "sampler": SdfSampler(50, 0.02, 50), "cache": tmp_path}
    full = SdfModule.from_runs(runs, tmp_path, augmented=True, **settings)
    assert full.ids == ["sphere", "bumpy", "ellipsoid", "dumbbell"]
    assert SdfModule.from_runs(runs, tmp_path, augmented=False, **settings).ids == full.ids[:3]
    carried = CorrespondenceModule.from_runs(runs, tmp_path, batching=batching)
    assert sorted(carried.ids[1:]) == ["bumpy", "dumbbell", "ellipsoid"]
    assert torch.equal(carried.clouds[carried.ids.index("bumpy")], full.clouds[1])


def test_empty_correspondences_name_the_stage(runs: dict[str, Run], tmp_path: Path) -> None:
    empty = {**runs, "correspond": Run(tmp_path / "nothing")}
    with pytest.raises(MissingData, match=r"holds no correspondences.*stage=correspond"):
        CorrespondenceModule.from_runs(empty, tmp_path, batching=Batching())
