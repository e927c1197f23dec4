"""Faults that must end in one clear line, and results that no fault may change."""

import errno
import io
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from commands import run_here, smoke_words
from compare import different

from gensp import occupancy
from gensp.checksums import listing, require_intact
from gensp.compute import Row, row_path, run_items, stored_rows
from gensp.data.shapes import ShapeCollection
from gensp.errors import BadMesh, DamagedFile, RunInUse, TrainingDiverged
from gensp.files import load_npz, read_json, read_rows, save_npz
from gensp.geometry.mesh import Mesh, load_mesh, save_mesh
from gensp.occupancy import occupied
from gensp.restarts import begin, clear, require_own, restart
from gensp.sharing import Workers
from gensp.stages.base import FitStage
from gensp.stages.callbacks import WholeCheckpoints

HOLDER = """
import sys, time
from pathlib import Path
from gensp.occupancy import occupied
from gensp.restarts import begin, clear, restart
with occupied(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def holder(folder: Path) -> subprocess.Popen[str]:
    """Another process that holds a folder."""
    command = [sys.executable, "-c", HOLDER, str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_folder_is_for_one_process_until_it_dies(tmp_path: Path) -> None:
    folder = tmp_path / "full" / "implicit"
    process = holder(folder)
    with pytest.raises(RunInUse, match="another process works in it"), occupied(folder):
        pass
    process.kill()
    process.communicate()
    with occupied(folder):
        (folder / "a.txt").touch()
        clear(folder)
        assert [path.name for path in folder.iterdir()] == [".lock"], "it is still held"
        with pytest.raises(RunInUse), occupied(folder):
            pass
        require_own(folder, "implicit")
        begin(folder, {"stage": {"name": "implicit"}})
        assert [entry.file for entry in listing(folder)] == ["settings.json"]
    assert [path.name for path in folder.iterdir()] == ["settings.json"]
    with occupied(tmp_path / "other" / "stage"):
        pass
    assert not (tmp_path / "other").exists(), "nothing was written"


def test_a_file_system_without_locks_is_told_and_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def no_locks(handle: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("gensp.occupancy.fcntl.flock", no_locks)
    with occupied(tmp_path / "stage"):
        assert (tmp_path / "stage").is_dir()
    said = " ".join(capsys.readouterr().out.split())
    assert said == (
        f"warning: {tmp_path}/stage: cannot be locked (No locks available); start no second "
        "command that writes into it"
    )


def test_a_lock_that_was_given_back_meanwhile_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its holder has removed the file between our opening and our locking it."""
    lock, flock = tmp_path / ".lock", occupancy.fcntl.flock
    removed = []

    def late(handle: int, operation: int) -> None:
        if not removed:
            removed.append(lock.unlink())
        flock(handle, operation)

    monkeypatch.setattr("gensp.occupancy.fcntl.flock", late)
    with occupied(tmp_path), pytest.raises(RunInUse), occupied(tmp_path):
        pass
    assert removed


def test_a_killed_holder_leaves_an_empty_folder_that_is_taken(tmp_path: Path) -> None:
    process = holder(tmp_path / "stage")
    process.kill()
    process.communicate()
    with occupied(tmp_path / "stage"):
        begin(tmp_path / "stage", {"stage": {"name": "augment"}})
    assert (tmp_path / "stage" / "settings.json").is_file()


@pytest.mark.slow
def test_a_stage_refuses_a_folder_in_use(smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / "augment"
    process = holder(folder)
    words = (*smoke_words(smoke_copy), "stage=augment")
    assert run_here(*words) is not None, "a finished stage is read, not written"
    with pytest.raises(RunInUse):
        run_here(*words, "force=true")
    process.kill()
    process.communicate()
    assert (folder / "manifest.json").is_file()


@pytest.mark.slow
def test_a_changed_predecessor_is_told_and_its_remaking_mends_it(
    smoke: Path, smoke_copy: Path
) -> None:
    run = smoke_copy / "smoke" / "full"
    model = run / "initialize" / "model.pt"
    data = bytearray(model.read_bytes())
    data[len(data) // 2] ^= 1
    model.write_bytes(data)
    (run / "finetune" / "manifest.json").unlink()
    words = smoke_words(smoke_copy)
    with pytest.raises(DamagedFile, match=r"model\.pt: was changed since.*stage=initialize force"):
        run_here(*words, "stage=finetune")
    run_here(*words, "stage=initialize", "force=true")
    run_here(*words, "stage=finetune")
    assert different(run / "finetune", smoke / "smoke" / "full" / "finetune") == []


@pytest.mark.slow
def test_a_truncated_checkpoint_is_told_and_training_anew_is_equal(
    smoke: Path, smoke_copy: Path
) -> None:
    folder = smoke_copy / "smoke" / "full" / "initialize"
    saved = folder / "checkpoints" / "last.ckpt"
    saved.write_bytes(saved.read_bytes()[:-1000])
    (folder / "manifest.json").unlink()
    words = (*smoke_words(smoke_copy), "stage=initialize")
    with pytest.raises(DamagedFile, match=r"last\.ckpt: is damaged .*remove it to train from"):
        run_here(*words)
    saved.unlink()
    run_here(*words)
    assert different(folder, smoke / "smoke" / "full" / "initialize") == []


def test_a_bit_of_a_checkpoint_counts(tmp_path: Path) -> None:
    path = tmp_path / "last.ckpt"
    WholeCheckpoints().save_checkpoint({"weights": torch.ones(1000)}, path)
    assert WholeCheckpoints().load_checkpoint(path)["weights"].sum() == 1000
    data = path.read_bytes()
    place = data.index(np.ones(1, "f4").tobytes() * 10)
    path.write_bytes(data[:place] + b"\x01" + data[place + 1 :])
    with pytest.raises(DamagedFile, match="was changed"):
        WholeCheckpoints().load_checkpoint(path)


@pytest.mark.parametrize("loss", [float("nan"), float("inf")])
def test_a_loss_that_is_no_number_ends_the_training(loss: float, tmp_path: Path) -> None:
    stage = FitStage(learning_rate=0.1, folder=tmp_path)
    stage._trainer = None
    stage.on_train_batch_end({"loss": torch.tensor(1.0)}, None, 0)
    with pytest.raises(TrainingDiverged, match=r"the loss is no finite number in epoch 0, step 0"):
        stage.on_train_batch_end({"loss": torch.tensor(loss)}, None, 0)


def test_weights_that_are_no_numbers_are_not_kept(tmp_path: Path) -> None:
    stage = FitStage(learning_rate=0.1, folder=tmp_path)
    stage.weight = torch.nn.Parameter(torch.tensor([1.0, torch.nan]))
    stage._trainer = None
    with pytest.raises(TrainingDiverged, match="a weight is no finite number"):
        stage.on_train_epoch_end()
    assert stage.history == []


def raises_at_b(item: str) -> Row:
    if item == "b":
        raise ZeroDivisionError("a fault of ours")
    return {"id": item}


def same(item: str) -> Row:
    return {"id": item}


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_worker_s_own_fault_is_loud_and_the_next_run_goes_on(tmp_path: Path, jobs: int) -> None:
    with pytest.raises(ZeroDivisionError):
        list(run_items(raises_at_b, ["a", "b"], tmp_path, Workers(jobs)))
    assert not row_path(tmp_path, "b").exists()
    list(run_items(same, ["a", "b"], tmp_path, Workers(jobs)))
    assert stored_rows(tmp_path) == [{"id": "a"}, {"id": "b"}]


@pytest.mark.parametrize("text", ["", '{"id"', "[]", "7", "\xff"])
def test_a_damaged_row_is_made_again(tmp_path: Path, text: str) -> None:
    list(run_items(same, ["a"], tmp_path, Workers(1)))
    row_path(tmp_path, "a").write_text(text, encoding="latin-1")
    assert list(run_items(same, ["a"], tmp_path, Workers(1))) == [{"id": "a"}]
    assert stored_rows(tmp_path) == [{"id": "a"}]


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"settings": 3}'])
def test_a_damaged_record_of_a_run_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(DamagedFile, match=r"settings\.json: is damaged"):
        restart(tmp_path, {"stage": {"name": "augment"}})


def test_a_missing_result_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("abc")
    files = list(listing(tmp_path))
    require_intact(tmp_path, files, "augment")
    (tmp_path / "a.txt").unlink()
    with pytest.raises(DamagedFile, match=r"a\.txt: is missing.*stage=augment force=true"):
        require_intact(tmp_path, files, "augment")


def test_an_array_larger_than_its_bytes_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(4.0))
    data = path.read_bytes()
    assert load_npz(path)["a"].tolist() == [0, 1, 2, 3]
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        huge, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", huge.getvalue() + data[-32:])
    with pytest.raises(DamagedFile, match="an array"):
        load_npz(path)


PLY = """ply
format {} 1.0
element vertex 2147483647
property float x
property float y
property float z
element face {}
property list {} int vertex_indices
end_header
"""
DECLARED = {
    "ascii.ply": PLY.format("ascii", 2147483647, "uchar").encode() + b"0 0 0\n",
    "binary.ply": PLY.format("binary_little_endian", 2147483647, "uchar").encode() + bytes(60),
    "corners.ply": PLY.replace("2147483647", "1")
    .format("binary_little_endian", 1, "uint")
    .encode()
    + bytes(12)
    + np.uint32(10**8).tobytes(),
    "a.off": b"OFF\n2147483647 2147483647 0\n0 0 0\n",
    "a.stl": bytes(80) + np.uint32(2**32 - 1).tobytes() + bytes(50),
    "a.obj": b"v 0 0 0\nf 1 1 99999999999\n",
}


@pytest.mark.parametrize("name", DECLARED)
def test_a_mesh_larger_than_its_bytes_takes_no_memory(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(DECLARED[name])
    tracemalloc.start()
    with pytest.raises(BadMesh, match=r"cannot be read|holds no triangles"):
        load_mesh(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


def test_arrays_come_back_in_order_kind_and_writable(tmp_path: Path) -> None:
    arrays = {
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "none": np.zeros((0, 3), np.int32),
        "text": np.array(["a", "éß"]),
        "one": np.array(True),
    }
    save_npz(tmp_path / "a.npz", **arrays)
    found = load_npz(tmp_path / "a.npz")
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
        assert found[name].flags.writeable


def test_damaged_tables_and_json_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2,3\n")
    (tmp_path / "a.json").write_text("[" * 100_000)
    for read, path in ((read_rows, "a.csv"), (read_json, "a.json")):
        with pytest.raises(DamagedFile, match=f"{path}: is damaged"):
            read(tmp_path / path)


@pytest.mark.parametrize("file", ["../outside.ply", "meshes/../../outside.ply"])
def test_names_in_a_manifest_lead_no_output_elsewhere(
    file: str, tmp_path: Path, bumpy: Mesh
) -> None:
    root = tmp_path / "shapes"
    (root / "meshes").mkdir(parents=True)
    save_mesh(bumpy, tmp_path / "outside.ply")
    (root / "manifest.csv").write_text(f"file\n{file}\n")
    assert ShapeCollection.from_folder(root).ids() == ["outside"]


@pytest.mark.slow
def test_mutated_files_are_refused_in_our_words() -> None:
    root = Path(__file__).parents[1]
    command = [sys.executable, "benchmarks/fuzz.py", "--inputs", "720", "--seed", "1"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
