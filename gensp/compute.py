"""Work on many shapes: one item, one process, one thread, one row.

Every item leaves `rows/<item>.json` behind when all its other files are in place, so a run that
was killed goes on with what is missing.
"""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from gensp.errors import DamagedFile, GenSPError, OutputError
from gensp.files import read_json, write_json

Row = dict[str, str | int | float | bool | None]
Task = Callable[[str], Row]

_THREADS = ("OMP_NUM_THREADS", "IGL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """How many processes share the items, and joblib's name of what runs them."""

    jobs: int = 0
    backend: str = "loky"

    def count(self, ranks: int = 1) -> int:
        """Processes for each of `ranks` ranks on this machine; jobs = 0 means all cores."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
        return max(1, (self.jobs or cores or os.cpu_count() or 1) // ranks)


def row_path(folder: Path, item: str) -> Path:
    """Where the row of an item is kept; characters that file names lack are quoted."""
    return folder / "rows" / f"{quote(item, safe='@+=, ')}.json"


def stored_rows(folder: Path) -> list[Row]:
    """All rows below a folder, ordered by their item's name."""
    # Names with a dot in front are halves that a killed run left.
    return [read_json(path) for path in sorted((folder / "rows").glob("[!.]*.json"))]


def finished_row(folder: Path, item: str) -> Row | None:
    """The stored row of an item, or None where it is missing, damaged or tells of a failure."""
    path = row_path(folder, item)
    try:
        row: Any = read_json(path) if path.is_file() else None
    except DamagedFile:
        return None
    return row if isinstance(row, dict) and not row.get("error") else None


def run_items(
    task: Task, items: Sequence[str], folder: Path, workers: Workers, *, ranks: int = 1
) -> Iterator[Row]:
    """Yield the row of every item as it is finished; rows of an earlier run come first.

    An item that ends in a GenSPError gives the row {"id", "error"} and is tried again next time.

    Raises
    ------
    OutputError
        A file could not be written.
    GenSPError
        A worker process died, for example for want of memory.
    """
    rows = {item: finished_row(folder, item) for item in items}
    yield from (row for row in rows.values() if row is not None)
    waiting = [item for item, row in rows.items() if row is None]
    count = min(workers.count(ranks), len(waiting))
    if count == 0:
        return
    calls = (joblib.delayed(_run_item)(task, item, folder) for item in waiting)
    with joblib.parallel_config(backend=workers.backend if count > 1 else "sequential"):
        parallel = joblib.Parallel(n_jobs=count, return_as="generator_unordered", batch_size=1)
        try:
            yield from parallel(calls)
        except TerminatedWorkerError as error:
            raise GenSPError(
                f"{folder}: a worker process died (often for want of memory, {count} ran at "
                "once); run the same command again to go on, with workers.jobs=1 if it recurs"
            ) from error


def _run_item(task: Task, item: str, folder: Path) -> Row:
    with _one_thread():
        try:
            row = task(item)
        except OutputError:
            raise
        except GenSPError as error:
            row = {"id": item, "error": str(error)}
    write_json(row_path(folder, item), row)
    return row


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for what runs inside, so that results do not depend on how many share them."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch else 1
    if torch:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if torch:
            torch.set_num_threads(before)
