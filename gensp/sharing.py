"""Who works at many items: processes of this machine, and what is done when one of them dies."""

import hashlib
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import cloudpickle
import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError

from gensp.errors import GenSPError

# loky ends a worker whose memory has grown and starts another: nothing is lost, nothing to do.
warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")

Work = Callable[[], Any]
WorkOf = Callable[[str], Work]  # what is to be done with an item, made only when its turn comes

Found = Callable[[str], Any]  # the result that a worker has left of an item, None where it has not

# (items, how many at once) → pairs of an item and its result, in the order in which they end.
Pool = Callable[[Sequence[str], int], Iterator[tuple[str, Any]]]

ATTEMPTS = 2  # an item at which so many workers die is given up, if nothing ran beside it


class WorkerDied(Exception):
    """A worker process died; what it had finished is on the disk.

    Parameters
    ----------
    suspects
        Items that may have been its death; each is tried again while nothing else runs.
    """

    def __init__(self, suspects: Sequence[str] = ()) -> None:
        super().__init__()
        self.suspects = list(suspects)


class Packed:
    """A task that is packed once and unpacked once in each process, however many items it has.

    A task holds its collection, whose list of shapes would travel with each of them. joblib maps
    a large array into the memory of its workers.
    """

    def __init__(self, task: Callable[[str], Any]) -> None:
        self.task = task

    def __call__(self, item: str) -> Any:
        """What the task gives for an item."""
        return self.task(item)

    @cached_property
    def _content(self) -> tuple[str, np.ndarray]:
        packed = cloudpickle.dumps(self.task)
        return hashlib.sha256(packed).hexdigest(), np.frombuffer(packed, np.uint8)

    def __reduce__(self) -> tuple[Callable[[str, np.ndarray], "Packed"], tuple[str, np.ndarray]]:
        return _unpacked, self._content


_UNPACKED: dict[str, Packed] = {}  # the last one


def _unpacked(digest: str, packed: np.ndarray) -> Packed:
    if digest not in _UNPACKED:
        task = cloudpickle.loads(packed.tobytes())
        _UNPACKED.clear()
        _UNPACKED[digest] = Packed(task)
    return _UNPACKED[digest]


@dataclass(frozen=True)
class Workers:
    """Processes of this machine that share the items.

    Attributes
    ----------
    jobs
        How many; 0: all cores.
    backend
        joblib's name of what runs them.
    isolated
        Whether a single process is a worker too: then its death is survived as that of one of
        many is. Otherwise one job is done by this process itself.
    """

    jobs: int = 0
    backend: str = "loky"
    isolated: bool = False

    def count(self, ranks: int = 1) -> int:
        """Processes for each of `ranks` ranks on this machine."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
        return max(1, (self.jobs or cores or os.cpu_count() or 1) // ranks)

    def pool(self, work: WorkOf, count: int, found: Found) -> AbstractContextManager[Pool]:
        """What does some work on items, `count` of them at once or fewer.

        The pool raises WorkerDied when it has given back what it could. It may ask for results
        that workers have left before these hand them over.
        """
        if count == 1 and not self.isolated:
            return nullcontext(partial(_in_turn, work))
        return nullcontext(partial(_by_joblib, work, self.backend))


def _in_turn(work: WorkOf, items: Sequence[str], count: int) -> Iterator[tuple[str, Any]]:
    yield from ((item, work(item)()) for item in items)


def _by_joblib(
    work: WorkOf, backend: str, items: Sequence[str], count: int
) -> Iterator[tuple[str, Any]]:
    left = dict.fromkeys(items)
    threads = {"inner_max_num_threads": 1} if backend == "loky" else {}
    for part in [items] if count > 1 else [[item] for item in items]:
        # With n_jobs=1 joblib would work in this process: two are made, one has something to do.
        jobs = max(2, min(count, len(part)))
        try:
            with joblib.parallel_config(backend=backend, **threads):
                parallel = joblib.Parallel(jobs, return_as="generator_unordered", batch_size=1)
                calls = (joblib.delayed(_named)(work(item), item) for item in part)
                for item, result in parallel(calls):
                    del left[item]
                    yield item, result
        except TerminatedWorkerError:
            # Items begin in order, so those that ran are among the first of those not finished.
            raise WorkerDied(list(left)) from None


def _named(work: Work, item: str) -> tuple[str, Any]:
    return item, work()


def shared_out(
    work: WorkOf,
    items: Sequence[str],
    workers: Workers,
    *,
    found: Found,
    what: Path | str,
    ranks: int = 1,
) -> Iterator[tuple[str, Any]]:
    """Pairs of an item and what its work gives, as they end; None for one given up.

    When a worker dies, the items that may have been its death are done again one at a time, and
    the others with half as many processes unless one of those was at fault.

    Parameters
    ----------
    found
        The result that a dead worker left of an item, None where it left none.
    what
        What is worked at, for warnings.

    Raises
    ------
    GenSPError
        Workers die without having done anything.
    """
    waiting, count, barren = dict.fromkeys(items), workers.count(ranks), 0
    if not waiting:
        return
    with workers.pool(work, count, found) as pool:
        while waiting:
            before = len(waiting)
            try:
                for item, result in pool(list(waiting), count):
                    del waiting[item]
                    yield item, result
            except WorkerDied as death:
                _warn(what)
                settled, count = _taken_up(pool, list(waiting), found, death.suspects, count)
                for item, result in settled:
                    del waiting[item]
                    yield item, result
            barren = barren + 1 if len(waiting) == before else 0
            _require_progress(barren, what)


def _warn(what: Path | str) -> None:
    warnings.warn(f"{what}: a worker died; its items are done again", stacklevel=3)


def _taken_up(
    pool: Pool,
    items: Sequence[str],
    found: Found,
    suspects: Sequence[str],
    count: int,
) -> tuple[list[tuple[str, Any]], int]:
    """What dead workers left, what comes of the items that may have killed them; the next count.

    If none of these did, it was the want of memory of all together, or a hand from outside.
    """
    left = [(item, found(item)) for item in items]
    missing = {item for item, result in left if result is None}
    again = [item for item in suspects if item in missing][:count]
    judged = [(item, _alone(pool, item, found)) for item in again]
    innocent = suspects and all(result is not None for _, result in judged)
    settled = [(item, result) for item, result in left if result is not None]
    return settled + judged, max(1, count // 2) if innocent else count


def _alone(pool: Pool, item: str, found: Found) -> Any:
    """What comes of an item while nothing else runs; None when its workers died."""
    result = None
    for _ in range(ATTEMPTS):
        try:
            return dict(pool([item], 1))[item]
        except WorkerDied:
            result = found(item)
        if result is not None:
            break
    return result


def _require_progress(barren: int, what: Path | str) -> None:
    if barren >= ATTEMPTS:
        raise GenSPError(
            f"{what}: all workers died twice before one item was done; memory, time limit and "
            "logs of the workers tell why; then run the same command again"
        )
