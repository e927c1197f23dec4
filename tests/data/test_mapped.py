"""Arrays on disk: the same batches as from memory, whole or made anew."""

import itertools
import os
import pickle
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gensp.data.batches import CorrespondenceDataset, EpochDataset, SdfDataset
from gensp.data.clouds import SurfaceSampler, point_clouds, sphere_cloud
from gensp.data.fitting import Batching
from gensp.data.loading import epoch_loader
from gensp.data.mapped import MappedArray, stored, write_rows
from gensp.data.sdf import SdfSampler
from gensp.data.training import CorrespondenceModule, SdfModule
from gensp.errors import DamagedFile, OutputError
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.sharing import Workers

SAMPLER = SdfSampler(near=60, far=60, uniform=60)
BATCHING = Batching(size=3, points=32, surface_points=20, cloud=64, draws=2, passes=2)


@pytest.fixture
def meshes() -> list[Mesh]:
    ball = icosphere(3)
    scales = [(1 + 0.1 * k, 1, 0.8) for k in range(5)]
    return [normalize(Mesh(ball.vertices * s, ball.faces, f"m{k}")) for k, s in enumerate(scales)]


def clouds_of(meshes: list[Mesh]) -> torch.Tensor:
    sphere = np.stack([sphere_cloud(64, draw) for draw in range(2)])
    return torch.from_numpy(np.stack([sphere, *(point_clouds(mesh, 64, 2) for mesh in meshes)]))


def require_same_batches(one: EpochDataset, other: EpochDataset) -> None:
    """Bit for bit, over three epochs."""
    loaders = [epoch_loader(dataset, batch_size=3) for dataset in (one, other)]
    for epoch in range(3):
        for loader in loaders:
            loader.sampler.set_epoch(epoch)
        for first, second in itertools.zip_longest(*loaders):
            for name, value in vars(first).items():
                found = getattr(second, name)
                same = torch.equal if isinstance(value, torch.Tensor) else type(value).__eq__
                assert same(value, found), name


def test_streamed_samples_are_those_held_in_memory(meshes: list[Mesh], tmp_path: Path) -> None:
    one = Workers(jobs=1)
    data = SdfModule(
        meshes, batching=BATCHING, sampler=SAMPLER, cache=tmp_path, seed=3, workers=one
    )
    pools = [SAMPLER.of_sphere(data.bound), *(SAMPLER(mesh, data.bound) for mesh in meshes)]
    held = SdfDataset(
        data.ids,
        clouds_of(meshes),
        torch.from_numpy(np.stack([pool.points for pool in pools])),
        torch.from_numpy(np.stack([pool.distances for pool in pools])),
        count=32,
        seed=3,
        passes=2,
    )
    require_same_batches(data.dataset(), held)


def test_streamed_correspondences_are_those_held_in_memory(meshes: list[Mesh]) -> None:
    targets = np.stack([mesh.vertices for mesh in meshes])
    valid = np.random.default_rng(0).random(targets.shape[:2]) < 0.8
    data = CorrespondenceModule(meshes, targets, valid, batching=BATCHING, seed=3)
    ball = icosphere(3).vertices
    held = CorrespondenceDataset(
        data.ids,
        clouds_of(meshes),
        torch.from_numpy(ball.astype(np.float32)),
        torch.from_numpy(np.concatenate([ball[None], targets]).astype(np.float32)),
        torch.from_numpy(np.concatenate([np.ones_like(valid[:1]), valid])),
        [SurfaceSampler.of(mesh) for mesh in (icosphere(5), *meshes)],
        count=32,
        surface_count=20,
        seed=3,
        passes=2,
    )
    require_same_batches(data.dataset(), held)


def test_the_mean_target_depends_on_its_parts_by_rounding_alone(
    meshes: list[Mesh], monkeypatch: pytest.MonkeyPatch
) -> None:
    targets = np.stack([mesh.vertices for mesh in meshes])
    valid = np.random.default_rng(0).random(targets.shape[:2]) < 0.8
    data = CorrespondenceModule(meshes, targets, valid, batching=BATCHING)
    items = [1, 2, 4, 5]
    whole = data.mean_target(items)
    known, places = data.valid[items].numpy()[..., None], data.targets[items].numpy()
    mean = np.where(known, places, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    expected = np.where(known.any(axis=0), mean, data.targets[0].numpy()).astype(np.float32)
    assert np.array_equal(whole, expected)
    monkeypatch.setattr("gensp.data.training._AT_ONCE", 50)  # a row at a time
    torch.testing.assert_close(data.mean_target(items), whole, rtol=1e-6, atol=1e-7)


class Rank:
    """What a data module asks of the trainer of one of two ranks."""

    world_size, num_devices, accumulate_grad_batches = 2, 1, 1

    def __init__(self, rank: int, wire: list[bytes]) -> None:
        self.global_rank, self.wire, self.strategy = rank, wire, self

    def broadcast(self, value: Any) -> Any:
        if self.global_rank == 0:
            self.wire.append(pickle.dumps(value))
        return pickle.loads(self.wire[0])


@pytest.mark.parametrize("kind", ["samples", "correspondences"])
def test_only_the_first_rank_names_and_checks(
    meshes: list[Mesh], tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(rank: int) -> SdfModule | CorrespondenceModule:
        targets = np.stack([mesh.vertices for mesh in meshes])
        valid = np.ones(targets.shape[:2], dtype=bool)
        if kind == "samples":
            shared = {"cache": tmp_path, "workers": Workers(jobs=1)}
            data = SdfModule(meshes, batching=BATCHING, sampler=SAMPLER, **shared)
        else:
            data = CorrespondenceModule(meshes, targets, valid, batching=BATCHING, store=tmp_path)
        data.trainer = Rank(rank, wire)
        return data

    def refused(*_: object) -> None:
        raise AssertionError("the second rank checks")

    wire: list[bytes] = []
    first, second = made(0), made(1)
    first.prepare_data()
    first.setup("fit")
    monkeypatch.setattr("gensp.data.arrays.stored", refused)
    monkeypatch.setattr("gensp.data.arrays.content_hash", refused)
    second.setup("fit")
    require_same_batches(second.dataset(), first.dataset())
    if kind == "samples":
        assert second.bound == first.bound


def test_an_array_gives_what_numpy_gives(tmp_path: Path) -> None:
    values = np.arange(24.0).reshape(4, 3, 2)
    write_rows(tmp_path / "a.npy", values, values.shape, np.float64)
    array = MappedArray(tmp_path / "a.npy")
    assert (len(array), array.shape, array.dtype) == (4, (4, 3, 2), np.float64)
    rows, columns = torch.tensor([[0], [3]]), torch.tensor([[2, 0], [1, 1]])
    np.testing.assert_array_equal(array[rows, columns], values[rows, columns])
    np.testing.assert_array_equal(array[1], values[1])
    array[1].zero_()  # a copy
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), values)


@pytest.fixture
def writes() -> list[Path]:
    return []


@pytest.fixture
def write(writes: list[Path]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        writes.append(folder)
        write_rows(folder / "a.npy", np.arange(1000.0), (1000,), np.float64)

    return write


def test_a_store_is_written_once(
    tmp_path: Path, write: Callable[[Path], None], writes: list[Path]
) -> None:
    for _ in range(2):
        assert stored(tmp_path, "k", write)["a"][[999]] == 999
    assert len(writes) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["k"]


@pytest.mark.parametrize("damage", ["truncate", "change", "remove", "manifest", "unlisted"])
def test_a_damaged_store_is_made_anew_with_a_warning(
    tmp_path: Path, write: Callable[[Path], None], damage: str
) -> None:
    stored(tmp_path, "k", write)
    path = tmp_path / "k" / "a.npy"
    data = bytearray(path.read_bytes())
    if damage == "truncate":
        path.write_bytes(data[:500])
    elif damage == "change":
        data[700] ^= 1
        path.write_bytes(data)
    elif damage == "remove":
        path.unlink()
    else:
        listed = "[]" if damage == "manifest" else "{}"
        (tmp_path / "k" / "manifest.json").write_text(listed)
    with pytest.warns(UserWarning, match=r"k: damaged; it is made anew"):
        found = stored(tmp_path, "k", write)
    np.testing.assert_array_equal(found["a"][:], np.arange(1000.0))


def test_a_damaged_store_that_cannot_be_removed_is_not_used(
    tmp_path: Path, write: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored(tmp_path, "k", write)
    (tmp_path / "k" / "a.npy").unlink()
    monkeypatch.setattr(shutil, "rmtree", lambda *_, **__: None)
    cannot = pytest.raises(OutputError, match=r"k: is damaged and cannot be removed")
    with pytest.warns(UserWarning, match="damaged"), cannot:
        stored(tmp_path, "k", write)


def test_what_a_killed_writer_left_is_removed(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    endless = (
        "import sys, time; from pathlib import Path; from gensp.data.mapped import stored;"
        "stored(Path(sys.argv[1]), 'j', lambda folder: (print(flush=True), time.sleep(600)))"
    )
    command = [sys.executable, "-c", endless, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        stored(tmp_path, "k", write)
        left = [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]
        assert len(left) == 1  # it lives
        writer.kill()
    stored(tmp_path, "k", write)
    assert [path.name for path in tmp_path.iterdir()] == ["k"]


def test_of_other_machines_only_what_is_old_is_removed(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    old, new = (tmp_path / f".k-elsewhere-{number}-abc" for number in (1, 2))
    mine = tmp_path / f".k-{socket.gethostname()}-{os.getpid()}-abc"
    for folder in (old, new, mine):
        folder.mkdir()
    for folder in (old, mine):
        os.utime(folder, (0, 0))
    stored(tmp_path, "k", write)
    assert {path.name for path in tmp_path.iterdir()} == {"k", new.name, mine.name}


def test_a_writer_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def full(folder: Path) -> None:
        (folder / "a.npy").write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match=r"k: cannot be written \(No space left.*paths\.cache"):
        stored(tmp_path, "k", full)
    assert list(tmp_path.iterdir()) == []


def test_an_array_cut_short_while_it_is_drawn_from_ends_with_one_line(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    array = stored(tmp_path, "k", write)["a"]
    array.path.write_bytes(array.path.read_bytes()[:500])
    with pytest.raises(DamagedFile, match=r"a\.npy: cannot be read any more.*made anew"):
        array[[3]]


def test_an_error_in_the_loaders_thread_reaches_the_training(meshes: list[Mesh]) -> None:
    valid = np.ones((5, 642), dtype=bool)
    targets = np.stack([mesh.vertices for mesh in meshes])
    data = CorrespondenceModule(meshes, targets, valid, batching=BATCHING)
    loader = data.train_dataloader()
    data.targets.path.unlink()
    with pytest.raises(DamagedFile, match=r"targets\.npy: cannot be read any more"):
        list(loader)
