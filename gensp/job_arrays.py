"""Items on many machines by job arrays of SLURM, with submitit: an extra of the package.

The run folder must be the same folder on all of them: a worker writes the files of its items.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

from gensp.clusters import needed
from gensp.errors import GenSPError
from gensp.sharing import Found, Pool, Work, WorkerDied, Workers, WorkOf, shared_out

# States of a task of SLURM that its items have not brought about.
_ENDED_EARLY = {"TIMEOUT", "PREEMPTED", "CANCELLED", "NODE_FAIL", "BOOT_FAIL", "REVOKED"}
_POLL = 10  # seconds between two looks at an array; a cluster's scheduler is asked seldom
_POLL_HERE = 1  # the same for processes of this machine


@dataclass(frozen=True)
class SlurmWorkers(Workers):
    """Tasks of a job array, each of which goes over its share of the items.

    Attributes
    ----------
    jobs
        Processes of every task.
    tasks
        Tasks of the array.
    cluster
        submitit's name of what runs them: slurm, or local for processes of this machine.
    minutes, memory_gb
        Limits of a task; no memory: the cluster's own.
    parameters
        Further parameters of submitit, such as slurm_partition.
    logs
        Where submitit keeps its files; to be seen by all machines.
    """

    jobs: int = 1
    tasks: int = 8
    cluster: str = "slurm"
    minutes: int = 240
    memory_gb: float | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    logs: Path | str = "runs/submitit"

    def count(self, ranks: int = 1) -> int:
        """Tasks of the array of each rank."""
        return max(1, self.tasks // ranks)

    def pool(self, work: WorkOf, count: int, found: Found) -> AbstractContextManager[Pool]:
        """Job arrays, one for every pass over the items."""
        return nullcontext(partial(_by_array, self, self._executor(), work, found))

    def _executor(self) -> Any:
        submitit = needed("submitit", "slurm")
        try:
            executor = submitit.AutoExecutor(folder=str(self.logs), cluster=self.cluster)
            executor.update_parameters(
                name="gensp-items",
                timeout_min=self.minutes,
                cpus_per_task=max(1, self.jobs),
                **({} if self.memory_gb is None else {"mem_gb": self.memory_gb}),
                **self.parameters,
            )
        except (RuntimeError, ValueError, NameError, TypeError) as error:
            raise GenSPError(
                f"compute=slurm: submitit cannot submit ({' '.join(str(error).split())}); a "
                "machine with sbatch is required; workers.cluster=local tries it on this one"
            ) from None
        return executor


def _by_array(
    workers: SlurmWorkers,
    executor: Any,
    work: WorkOf,
    found: Found,
    items: Sequence[str],
    count: int,
) -> Iterator[tuple[str, Any]]:
    """Every task takes up what dies in it; a task that dies itself is told at the end."""
    shares = [
        {item: work(item) for item in items[k::count]} for k in range(min(count, len(items)))
    ]
    own = Workers(jobs=max(1, workers.jobs), isolated=True)
    jobs = executor.map_array(partial(run_share, own), shares)
    left = {job: dict.fromkeys(share) for job, share in zip(jobs, shares, strict=True)}
    pause = _POLL if workers.cluster == "slurm" else _POLL_HERE
    died: list[list[str]] = []
    try:
        while left:
            for job in list(left):
                ended = _ended(job, list(left[job]), died) if job.done() else None
                arrived = _arrived(list(left[job]), found, own.jobs) if ended is None else ended
                for item, result in arrived:
                    del left[job][item]
                    yield item, result
                if ended is not None:
                    del left[job]
            if left:
                time.sleep(pause)
    finally:
        for job in jobs:
            if not job.done():
                job.cancel()
    if died:
        raise WorkerDied(_in_turns(died))


def _arrived(items: Sequence[str], found: Found, ahead: int) -> Iterator[tuple[str, Any]]:
    """What a task that runs has left so far; it begins its items in order, `ahead` at once."""
    for item in items:
        result = found(item)
        if result is not None:
            yield item, result
        else:
            ahead -= 1
        if not ahead:
            break


def _ended(job: Any, items: Sequence[str], died: list[list[str]]) -> list[tuple[str, Any]]:
    """What a task handed back of these items; if it died, they are added to the suspects."""
    submitit, missing = needed("submitit", "slurm"), set(items)
    try:
        return [(item, result) for item, result in _told(job.result()) if item in missing]
    except submitit.core.utils.FailedJobError:
        raise
    except submitit.core.utils.UncompletedJobError:
        died.append([] if _is_nobodys_fault(job) else list(items))
        return []


def _is_nobodys_fault(job: Any) -> bool:
    """Whether a task ended for its time, its node or by hand: then no item is at fault."""
    return str(job.state).split(" ")[0] in _ENDED_EARLY


def _in_turns(shares: Sequence[Sequence[str]]) -> list[str]:
    """First the first items of all shares: a share is begun with those."""
    turns = zip_longest(*shares)
    return [item for turn in turns for item in turn if item is not None]


def _told(result: list[tuple[str, Any]] | GenSPError) -> list[tuple[str, Any]]:
    """What a task handed back; an error of ours is raised here, where it is one line."""
    if isinstance(result, GenSPError):
        raise result
    return result


def run_share(workers: Workers, share: Mapping[str, Work]) -> list[tuple[str, Any]] | GenSPError:
    """What one task of an array does.

    An error of ours is handed back as a value: of one that is raised submitit keeps the trace
    alone.
    """
    done = shared_out(share.__getitem__, list(share), workers, found=_nothing, what="items")
    try:
        return list(done)
    except GenSPError as error:
        return error


def _nothing(item: str) -> None:
    """A task of an array does not know where its work leaves what."""
