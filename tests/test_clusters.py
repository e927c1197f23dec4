"""Items over dask, ray and submitit, each on this machine."""

import json
import logging
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import distributed
import pytest
import submitit
from commands import ROOT, run_here, smoke_words, train
from compare import different
from trying import Trying

from gensp.clusters import _TALKATIVE, DaskWorkers, RayWorkers, needed
from gensp.compute import Row, run_items, stored_rows
from gensp.errors import GenSPError, MissingData, OutputError
from gensp.job_arrays import SlurmWorkers, _by_array, _is_nobodys_fault
from gensp.sharing import Packed, Workers

pytestmark = pytest.mark.slow

ITEMS = ["a", "b@3", "bad", "c/d", "e", "f"]


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


@pytest.mark.parametrize("workers", ["dask", "ray"], indirect=True)
def test_a_task_travels_once_however_many_items_it_has(
    workers: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []
    packed = Packed.__reduce__

    def counted(task: Packed) -> Any:
        sent.append(task)
        return packed(task)

    monkeypatch.setattr(Packed, "__reduce__", counted)
    items = [f"item{k}" for k in range(12)]
    rows = list(run_items(Trying(tmp_path), items, tmp_path / "run", workers))
    assert len(rows) == 12
    # dask looks first whether plain pickle would do.
    assert 1 <= len(sent) <= 3


def test_rows_of_a_task_of_an_array_are_told_before_it_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two tasks of three items each, which leave one row between two looks."""
    left: dict[str, int] = {}
    result = {item: ord(item) for item in "abcdef"}
    looks: list[str] = []

    def look(seconds: float) -> None:
        looks.append("")
        left.update({item: result[item] for item in "abcdef"[: 2 * len(looks)]})

    class Job:
        def __init__(self, share: Any) -> None:
            self.share = share

        def done(self) -> bool:
            return len(looks) >= 3

        def result(self) -> list[tuple[str, int]]:
            return [(item, result[item]) for item in self.share]

    monkeypatch.setattr("gensp.job_arrays.time", SimpleNamespace(sleep=look))
    executor = SimpleNamespace(map_array=lambda task, shares: [Job(share) for share in shares])
    told = []
    rows = _by_array(SlurmWorkers(), executor, lambda item: str, left.get, "abcdef", 2)
    for item, value in rows:
        assert value == result[item]
        told.append(f"{item} after {len(looks)}")
    assert told == ["a after 1", "b after 1", "c after 2", "d after 2", "e after 3", "f after 3"]


@pytest.mark.parametrize("workers", ["slurm"], indirect=True)
def test_an_item_that_kills_the_task_of_an_array_is_given_up(
    workers: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # submitit waits so long for the result of a dead task.
    monkeypatch.setattr(submitit.Job, "_results_timeout_s", 1)
    task = Trying(tmp_path, once=("a",), always=("c/d",), whom=os.getppid)
    with pytest.warns(UserWarning, match="a worker died"):
        rows = list(run_items(task, ITEMS, tmp_path / "run", workers))
    assert sorted(str(row["id"]) for row in rows) == ITEMS
    failed = {
        row["id"]: str(row["error"]) for row in stored_rows(tmp_path / "run") if "error" in row
    }
    assert sorted(failed) == ["bad", "c/d"]
    assert "c/d: its worker process died 2 times while nothing ran beside it" in failed["c/d"]


@pytest.mark.parametrize("state", ["TIMEOUT", "CANCELLED by 1000", "NODE_FAIL"])
def test_no_item_is_to_blame_for_a_time_limit(state: str) -> None:
    assert _is_nobodys_fault(SimpleNamespace(state=state))
    assert not _is_nobodys_fault(SimpleNamespace(state="OUT_OF_MEMORY"))


@pytest.mark.parametrize("workers", ["dask", "ray", "slurm"], indirect=True)
def test_a_full_disk_is_told_as_on_one_machine(workers: Workers, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"^full: cannot be written$"):
        list(run_items(Trying(tmp_path), ["full"], tmp_path / "run", workers))


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


def test_workers_that_begin_elsewhere_write_into_the_run_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [str(ROOT), str(Path(__file__).parent), *sys.path]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(places))
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    elsewhere.mkdir()
    here.mkdir()
    monkeypatch.chdir(elsewhere)
    levels = [logging.getLogger(name).level for name in _TALKATIVE]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        monkeypatch.chdir(here)
        words = (*smoke_words(Path("runs")), "stage=augment", "compute=dask", "logger=none")
        run_here(*words, f"workers.address={cluster.scheduler_address}")
    folder = here / "runs" / "smoke" / "full" / "augment"
    assert json.loads((folder / "manifest.json").read_text())["metrics"]["items"] > 0
    assert list(folder.glob("rows/*.json"))
    assert not list(elsewhere.iterdir())
    told = [path for path in folder.rglob("*") if path.suffix in (".json", ".yaml", ".csv")]
    assert not [path for path in told if str(tmp_path) in path.read_text()]
    assert [logging.getLogger(name).level for name in _TALKATIVE] == levels


def test_slurm_without_sbatch_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(GenSPError, match=r"compute=slurm: submitit cannot submit .* sbatch"):
        list(run_items(Trying(tmp_path), ITEMS, tmp_path, SlurmWorkers(logs=tmp_path / "logs")))


def test_what_is_there_is_found() -> None:
    assert needed("json", "dask").loads("[]") == []
