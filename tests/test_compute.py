"""Items over workers: rows, skipping, failures, dead workers."""

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from gensp.compute import Row, Workers, finished_row, row_path, run_items, stored_rows
from gensp.errors import BadMesh, GenSPError, OutputError
from gensp.runs import tidy

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


@dataclass(frozen=True)
class Fatal:
    """Dies, or meets a full disk."""

    way: str

    def __call__(self, item: str) -> Row:
        if self.way == "exit" and item == "b@3":
            os._exit(1)
        if self.way == "disk":
            raise OutputError(f"{item}: cannot be written")
        return {"id": item}


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


def test_a_full_disk_ends_the_run(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        list(run_items(Fatal("disk"), ITEMS, tmp_path, Workers(1)))
    assert stored_rows(tmp_path) == []


def test_a_dead_worker_is_told(tmp_path: Path) -> None:
    with pytest.raises(GenSPError, match=r"worker process died .* workers.jobs=1"):
        list(run_items(Fatal("exit"), ITEMS, tmp_path, Workers(2)))


def test_ranks_share_the_cores() -> None:
    assert Workers(8).count() == 8
    assert Workers(8).count(ranks=2) == 4
    assert Workers(1).count(ranks=2) == 1
    assert Workers().count() == len(os.sched_getaffinity(0))
