"""Items over dask, ray and submitit, each on this machine."""

import os
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import distributed
import pytest
from commands import smoke_words, train
from compare import different

from gensp.job_arrays import SlurmWorkers
from gensp.clusters import DaskWorkers, RayWorkers, needed
from gensp.compute import Row, Workers, run_items, stored_rows
from gensp.errors import BadMesh, GenSPError, MissingData

pytestmark = pytest.mark.slow

ITEMS = ["a", "b@3", "bad", "c/d", "e", "f"]


@dataclass(frozen=True)
class Trying:
    """Fails at one item, and kills its process at others, once or always."""

    folder: Path
    once: tuple[str, ...] = ()
    always: tuple[str, ...] = ()

    def __call__(self, item: str) -> Row:
        if item == "bad":
            raise BadMesh(f"{item}: found holes")
        mark = self.folder / f"{item.replace('/', '-')}.died"
        if item in self.always or (item in self.once and not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"id": item, "process": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


@dataclass(frozen=True)
class Ending:
    """Kills the task of the array that its process belongs to, once."""

    folder: Path

    def __call__(self, item: str) -> Row:
        mark = self.folder / "ended"
        if item == "e" and not mark.exists():
            mark.touch()
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(3)
        return {"id": item}


def fault(item: str) -> Row:
    raise ZeroDivisionError("a fault of ours")


@pytest.fixture
def workers(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Workers:
    """Workers of this machine, which find the module of the tests."""
    places = [str(Path(__file__).parent), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(places))
    logs = tmp_path / "submitit"
    return {
        "dask": DaskWorkers(jobs=2),
        "ray": RayWorkers(jobs=2),
        "slurm": SlurmWorkers(cluster="local", tasks=2, jobs=1, minutes=5, logs=logs),
    }[request.param]


@pytest.mark.filterwarnings("ignore:.*a worker died")
@pytest.mark.parametrize("workers", ["dask", "ray", "slurm"], indirect=True)
def test_every_item_has_its_row_whoever_dies(workers: Workers, tmp_path: Path) -> None:
    task = Trying(tmp_path, once=("b@3",), always=("c/d",))
    rows = list(run_items(task, ITEMS, tmp_path / "run", workers))
    assert sorted(str(row["id"]) for row in rows) == ITEMS
    stored = {str(row["id"]): row for row in stored_rows(tmp_path / "run")}
    assert list(stored) == ITEMS
    assert stored["bad"]["error"] == "bad: found holes"
    assert "c/d: its worker process died 2 times" in str(stored["c/d"]["error"])
    done = [row for row in stored.values() if "error" not in row]
    assert [row["id"] for row in done] == ["a", "b@3", "e", "f"]
    assert all(row["process"] != os.getpid() and row["threads"] == "1" for row in done)
    # Finished before: nobody is asked.
    kept = list(run_items(Trying(tmp_path), ["a", "e"], tmp_path / "run", workers))
    assert kept == [stored["a"], stored["e"]]


@pytest.mark.parametrize("workers", ["slurm"], indirect=True)
def test_an_array_is_followed_by_one_of_what_is_left(workers: Workers, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="a worker died"):
        rows = list(run_items(Ending(tmp_path), ITEMS, tmp_path / "run", workers))
    assert sorted(str(row["id"]) for row in rows) == ITEMS
    assert not any("error" in row for row in stored_rows(tmp_path / "run"))


@pytest.mark.parametrize("workers", ["dask", "ray", "slurm"], indirect=True)
def test_a_fault_of_the_program_is_loud(workers: Workers, tmp_path: Path) -> None:
    with pytest.raises(Exception, match="a fault of ours"):
        list(run_items(fault, ["a", "e"], tmp_path / "run", workers))
    assert stored_rows(tmp_path / "run") == []


@pytest.mark.parametrize(
    ("kind", "start"), [(DaskWorkers, "dask scheduler"), (RayWorkers, "ray start --head")]
)
@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere"])
def test_a_scheduler_that_does_not_answer_is_told(
    kind: type[DaskWorkers], start: str, address: str, tmp_path: Path
) -> None:
    with pytest.raises(GenSPError, match=f"no scheduler was found at {address} .*'{start}'"):
        list(run_items(Trying(tmp_path), ITEMS, tmp_path, kind(address=address)))


@pytest.mark.parametrize(
    ("workers", "module", "extra"),
    [("dask", "distributed", "dask"), ("ray", "ray", "ray"), ("slurm", "submitit", "slurm")],
    indirect=["workers"],
)
def test_a_missing_extra_names_the_command(
    workers: Workers, module: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingData, match=rf"type: pip install 'gensp\[{extra}\]'"):
        list(run_items(Trying(tmp_path), ITEMS, tmp_path, workers))


@pytest.mark.parametrize("compute", ["dask", "submitit_local"])
def test_a_stage_is_the_same_wherever_it_is_made(
    compute: str, smoke: Path, smoke_copy: Path
) -> None:
    folder = smoke_copy / "smoke" / "full" / "augment"
    shutil.rmtree(folder)
    train(*smoke_words(smoke_copy), "stage=augment", f"compute={compute}")
    assert different(folder, smoke / "smoke" / "full" / "augment") == []


def test_a_scheduler_that_runs_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    options = {"threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(n_workers=2, **options) as cluster:
        workers = DaskWorkers(address=cluster.scheduler_address.removeprefix("tcp://"))
        assert workers.count() == 2
        assert workers.count(ranks=2) == 1
        task = Trying(tmp_path, once=("b@3",))
        rows = list(run_items(task, ITEMS, tmp_path / "run", workers))
    assert [row["id"] for row in rows if "error" in row] == ["bad"]
    with distributed.LocalCluster(n_workers=0, **options) as cluster:
        workers = DaskWorkers(address=cluster.scheduler_address)
        with pytest.raises(GenSPError, match=r"the scheduler has no workers; .* workers\.jobs=N"):
            workers.count()


def test_slurm_without_sbatch_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(GenSPError, match=r"compute=slurm: submitit cannot submit .* sbatch"):
        list(run_items(Trying(tmp_path), ITEMS, tmp_path, SlurmWorkers(logs=tmp_path / "logs")))


def test_what_is_there_is_found() -> None:
    assert needed("json", "dask").loads("[]") == []
