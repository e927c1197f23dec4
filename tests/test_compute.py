"""Items over workers: rows, skipping, failures, dead workers."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from trying import Trying

from gensp.compute import Row, finished_row, row_path, run_items, stored_rows
from gensp.errors import BadMesh, GenSPError, OutputError
from gensp.machine import noted_peak_memories
from gensp.restarts import tidy
from gensp.sharing import WorkerDied, Workers, shared_out

ITEMS = ["a", "b@3", "c/d"]


@dataclass(frozen=True)
class Mark:
    """Leaves a line for every call, so that calls can be counted across processes."""

    folder: Path
    fails: str = ""

    def __call__(self, item: str) -> Row:
        with open(self.folder / "calls.txt", "a") as file:
            file.write(f"{item}\n")
        if item == self.fails:
            raise BadMesh(f"{item}: found holes")
        return {"id": item, "threads": os.environ.get("OMP_NUM_THREADS")}

    @property
    def calls(self) -> list[str]:
        return sorted((self.folder / "calls.txt").read_text().split())


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_once(tmp_path: Path, jobs: int) -> None:
    task = Mark(tmp_path)
    rows = list(run_items(task, ITEMS, tmp_path, Workers(jobs)))
    assert sorted(str(row["id"]) for row in rows) == ITEMS
    assert [row["id"] for row in stored_rows(tmp_path)] == ITEMS
    assert all(row["threads"] == "1" for row in rows)
    again = list(run_items(task, ITEMS, tmp_path, Workers(jobs)))
    assert again == stored_rows(tmp_path)
    assert task.calls == ITEMS


class Counted:
    """Leaves a line for every time that it is read, and is as large as asked for."""

    def __init__(self, folder: Path, size: int) -> None:
        self.folder, self.names = folder, [f"shape {number}" for number in range(size)]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ = state
        with open(self.folder / "read.txt", "a") as file:
            file.write(f"{os.getpid()}\n")

    def __call__(self, item: str) -> Row:
        time.sleep(0.05)  # so that all workers get some
        return {"id": item, "process": os.getpid(), "names": len(self.names)}


@pytest.mark.parametrize("size", [10, 200_000])
def test_a_worker_reads_a_task_once_for_all_items(tmp_path: Path, size: int) -> None:
    items = [f"i{number}" for number in range(12)]
    rows = list(run_items(Counted(tmp_path, size), items, tmp_path, Workers(2)))
    assert sorted(str(row["id"]) for row in rows) == sorted(items)
    assert all(row["names"] == size for row in rows)
    read = (tmp_path / "read.txt").read_text().split()
    assert sorted(set(read)) == sorted({str(row["process"]) for row in rows})
    assert len(read) == len(set(read))


def test_a_task_of_a_notebook_travels(tmp_path: Path) -> None:
    """It has no module that a worker could read."""
    length = len(ITEMS)
    rows = list(run_items(lambda item: {"id": item, "n": length}, ITEMS, tmp_path, Workers(2)))
    assert sorted(str(row["id"]) for row in rows) == ITEMS
    assert all(row["n"] == length for row in rows)


def test_only_the_missing_items_are_done(tmp_path: Path) -> None:
    list(run_items(Mark(tmp_path), ITEMS, tmp_path, Workers(1)))
    row_path(tmp_path, "c/d").unlink()
    list(run_items(Mark(tmp_path), ITEMS, tmp_path, Workers(1)))
    assert Mark(tmp_path).calls == [*ITEMS, "c/d"]


def test_a_failed_item_is_a_row_and_is_tried_again(tmp_path: Path) -> None:
    rows = list(run_items(Mark(tmp_path, fails="a"), ITEMS, tmp_path, Workers(1)))
    assert rows[0] == {"id": "a", "error": "a: found holes"}
    assert finished_row(tmp_path, "a") is None
    list(run_items(Mark(tmp_path), ITEMS, tmp_path, Workers(1)))
    assert Mark(tmp_path).calls == ["a", "a", "b@3", "c/d"]
    assert finished_row(tmp_path, "a") is not None


def test_halves_of_a_killed_run_are_no_rows(tmp_path: Path) -> None:
    list(run_items(Mark(tmp_path), ITEMS, tmp_path, Workers(1)))
    (tmp_path / "rows" / ".a-x1y2.json").write_text('{"id"')
    assert [row["id"] for row in stored_rows(tmp_path)] == ITEMS
    tidy(tmp_path)
    assert not (tmp_path / "rows" / ".a-x1y2.json").exists()
    assert len(stored_rows(tmp_path)) == len(ITEMS)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_full_disk_ends_the_run(tmp_path: Path, jobs: int) -> None:
    with pytest.raises(OutputError, match="full: cannot be written"):
        list(run_items(Trying(tmp_path), ["full"], tmp_path, Workers(jobs)))
    assert stored_rows(tmp_path) == []


MANY = [*ITEMS, "e", "f"]
WORKERS = {"two": Workers(2), "one": Workers(1, isolated=True), "three": Workers(3)}


@pytest.mark.parametrize("name", WORKERS)
def test_a_worker_that_is_killed_once_loses_nothing(tmp_path: Path, name: str) -> None:
    task = Trying(tmp_path, once=("b@3", "f"))
    with pytest.warns(UserWarning, match="a worker died; its items are done again"):
        rows = list(run_items(task, MANY, tmp_path, WORKERS[name]))
    assert sorted(str(row["id"]) for row in rows) == MANY
    assert not any("error" in row or row["process"] == os.getpid() for row in rows)
    assert [row["id"] for row in stored_rows(tmp_path)] == MANY


@pytest.mark.parametrize("name", WORKERS)
def test_an_item_that_always_kills_is_given_up(tmp_path: Path, name: str) -> None:
    task = Trying(tmp_path, always=("c/d",))
    with pytest.warns(UserWarning, match="a worker died"):
        rows = list(run_items(task, MANY, tmp_path, WORKERS[name]))
    assert sorted(str(row["id"]) for row in rows) == MANY
    failed = [row for row in stored_rows(tmp_path) if "error" in row]
    assert [row["id"] for row in failed] == ["c/d"]
    assert "c/d: its worker process died 2 times while nothing ran beside it" in str(failed)
    assert finished_row(tmp_path, "c/d") is None, "tried again next time"
    again = list(run_items(Trying(tmp_path), MANY, tmp_path, WORKERS[name]))
    assert all("error" not in row for row in again)


def test_a_row_that_a_dead_worker_left_counts(tmp_path: Path) -> None:
    """A worker may die between an item's row and the word that it is done."""
    left = {"a": 1}
    done: list[str] = []

    @contextmanager
    def pool(work: Any, count: int, found: Any) -> Iterator[Any]:
        def attempt(items: Sequence[str], most: int) -> Iterator[tuple[str, int]]:
            done.append(f"{','.join(items)} by {most}")
            if len(items) > 1 and most > 2:
                raise WorkerDied(items)
            yield from ((item, 2) for item in items)

        yield attempt

    workers = SimpleNamespace(count=lambda ranks: 4, pool=pool)
    items = list("abcdefg")
    with pytest.warns(UserWarning, match="here: a worker died"):
        pairs = dict(shared_out(str, items, workers, found=left.get, what="here"))
    assert pairs == {"a": 1, **dict.fromkeys("bcdefg", 2)}
    # Four may have been its death; none was: the others go on with half as many processes.
    assert done == ["a,b,c,d,e,f,g by 4", "b by 1", "c by 1", "d by 1", "e by 1", "f,g by 2"]


def test_workers_that_die_before_they_work_are_told() -> None:
    @contextmanager
    def pool(work: Any, count: int, found: Any) -> Iterator[Any]:
        def attempt(items: Sequence[str], most: int) -> Iterator[tuple[str, int]]:
            raise WorkerDied
            yield

        yield attempt

    workers = SimpleNamespace(count=lambda ranks: 1, pool=pool)
    with pytest.raises(GenSPError, match="here: all workers died twice before one item was done"):
        list(shared_out(str, ["a"], workers, found=lambda item: None, what="here"))


def test_rows_that_are_written_elsewhere_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker whose run folder is another one than this command's."""

    @contextmanager
    def pool(work: Any, count: int, found: Any) -> Iterator[Any]:
        yield lambda items, most: iter([(item, {"id": item}) for item in items])

    workers = SimpleNamespace(count=lambda ranks: 1, pool=pool)
    monkeypatch.setattr("gensp.compute._PATIENCE", 0.3)
    with pytest.raises(GenSPError, match="the run folder must be the same folder on all machines"):
        list(run_items(Trying(tmp_path), ITEMS, tmp_path, workers))


def test_ranks_share_the_cores() -> None:
    assert Workers(8).count() == 8
    assert Workers(8).count(ranks=2) == 4
    assert Workers(1).count(ranks=2) == 1
    assert Workers().count() == len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Large:
    """Takes half a GiB for one item, after which its worker is killed at another."""

    folder: Path
    trying: Trying

    def __call__(self, item: str) -> Row:
        if item == "a":
            block = bytearray(2**29)
            return {"id": item, "bytes": len(block)}
        return self.trying(item)


def test_workers_tell_how_much_memory_they_took(tmp_path: Path) -> None:
    """Also one that is dead when it is asked for; the rows are what they were."""
    task = Large(tmp_path, Trying(tmp_path, once=("b@3",)))
    with pytest.warns(UserWarning, match="a worker died"):
        rows = list(run_items(task, ITEMS, tmp_path, Workers(1, isolated=True)))
    assert {"id": "a", "bytes": 2**29} in rows
    peaks = noted_peak_memories(tmp_path)
    assert len(peaks) == len({row["process"] for row in rows if "process" in row}) + 1
    assert 0.5 < max(peaks) < 2
    assert min(peaks) < max(peaks) - 0.3
    assert noted_peak_memories(tmp_path) == []


def test_a_process_that_does_the_items_itself_notes_nothing(tmp_path: Path) -> None:
    list(run_items(Mark(tmp_path), ITEMS, tmp_path, Workers(1)))
    (tmp_path / ".memory-elsewhere-7").write_text("")
    assert noted_peak_memories(tmp_path) == []
