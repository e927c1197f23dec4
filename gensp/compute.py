"""Work on many shapes: one item, one process, one thread, one row.

Every item leaves `rows/<item>.json` behind when all its other files are in place, so a run that
was killed goes on with what is missing, and a worker that dies takes nothing with it. Rows of
many items lie in many folders, see `gensp.layout`.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from gensp.errors import DamagedFile, GenSPError, OutputError
from gensp.files import read_json, write_json
from gensp.layout import item_files, item_folder, lay_out
from gensp.machine import note_peak_memory, process_name
from gensp.sharing import ATTEMPTS, Packed, Workers, shared_out

Row = dict[str, str | int | float | bool | None]
Task = Callable[[str], Row]
_THREADS = ("OMP_NUM_THREADS", "IGL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_PATIENCE = 90  # seconds after which a file of another machine is seen, with NFS's own defaults


def row_path(folder: Path, item: str) -> Path:
    """Where the row of an item is kept; characters that file names lack are quoted."""
    return item_folder(folder, "rows", item) / f"{quote(item, safe='@+=, ')}.json"


def stored_rows(folder: Path) -> list[Row]:
    """All rows below a folder, ordered by their item's name."""
    return [read_json(path) for path in item_files(folder, "rows", ".json")]


def stored_row(folder: Path, item: str) -> Row | None:
    """The stored row of an item, or None where it is missing or damaged."""
    path = row_path(folder, item)
    try:
        row: Any = read_json(path) if path.is_file() else None
    except DamagedFile:
        return None
    return row if isinstance(row, dict) else None


def finished_row(folder: Path, item: str) -> Row | None:
    """The stored row of an item, or None where it is missing, damaged or tells of a failure."""
    row = stored_row(folder, item)
    return row if row is not None and not row.get("error") else None


def run_items(
    task: Task, items: Sequence[str], folder: Path, workers: Workers, *, ranks: int = 1
) -> Iterator[Row]:
    """Yield the row of every item as it is finished; rows of an earlier run come first.

    An item that ends in a GenSPError gives the row {"id", "error"} and is tried again next time;
    so does an item at which its worker dies twice while nothing else runs.

    Parameters
    ----------
    ranks
        Ranks on this machine, each of which has items of its own.

    Raises
    ------
    OutputError
        A file could not be written.
    GenSPError
        Workers write into another folder than this one, or die without having done anything.
    """
    lay_out(folder, len(items))
    rows = {item: finished_row(folder, item) for item in items}
    yield from (row for row in rows.values() if row is not None)
    waiting = [item for item, row in rows.items() if row is None]
    for item in waiting:
        # A row that is found later is of this run.
        row_path(folder, item).unlink(missing_ok=True)
    work = partial(partial, _run_item, Packed(task), folder, process_name())
    found = partial(stored_row, folder)
    for item, row in shared_out(work, waiting, workers, ranks=ranks, found=found, what=folder):
        if row is not None:
            require_seen(row_path(folder, item), folder)
        yield _given_up(folder, item) if row is None else row


def require_seen(path: Path, folder: Path) -> None:
    """Refuse work that was done on a machine which wrote its files elsewhere.

    Raises
    ------
    GenSPError
        A file in the folder that a worker has written is not there.
    """
    until = time.monotonic() + _PATIENCE
    while not path.is_file():
        if time.monotonic() >= until:
            raise GenSPError(
                f"{path}: a worker has written it, but it was not found here; the run folder must "
                f"be the same folder on all machines: {folder.absolute()}; put it, with "
                "paths.runs=FOLDER and paths.cache=FOLDER, on a file system that all of them share"
            )
        time.sleep(0.2)


def _given_up(folder: Path, item: str) -> Row:
    row: Row = {
        "id": item,
        "error": f"{item}: its worker process died {ATTEMPTS} times while nothing ran beside it, "
        "often for want of memory; simplify the mesh, or leave it out",
    }
    write_json(row_path(folder, item), row)
    return row


def _run_item(task: Task, folder: Path, asked_by: str, item: str) -> Row:
    with _one_thread():
        try:
            row = task(item)
        except OutputError:
            raise
        except GenSPError as error:
            row = {"id": item, "error": str(error)}
    if process_name() != asked_by:  # which tells its memory itself
        note_peak_memory(folder)
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
