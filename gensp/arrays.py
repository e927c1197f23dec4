"""Items on many machines by job arrays of SLURM, with submitit: an extra of the package.

The run folder must be the same folder on all of them: a worker writes the files of its items.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from gensp.clusters import needed
from gensp.compute import Pool, Work, WorkerDied, Workers, WorkOf, shared_out
from gensp.errors import GenSPError


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

    def pool(self, work: WorkOf, count: int) -> AbstractContextManager[Pool]:
        """Job arrays, one for every pass over the items."""
        return nullcontext(partial(_by_array, self, self._executor(), work))

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
    workers: SlurmWorkers, executor: Any, work: WorkOf, items: Sequence[str], count: int
) -> Iterator[tuple[str, Any]]:
    """Every task takes up what dies in it; a task that dies itself is told at the end."""
    submitit = needed("submitit", "slurm")
    shares = [
        {item: work(item) for item in items[k::count]} for k in range(min(count, len(items)))
    ]
    own = Workers(jobs=max(1, workers.jobs), isolated=True)
    jobs = executor.map_array(partial(run_share, own), shares)
    died = False
    try:
        for job in submitit.helpers.as_completed(jobs):
            try:
                yield from job.result()
            except submitit.core.utils.FailedJobError:
                raise
            except submitit.core.utils.UncompletedJobError:
                died = True
    finally:
        for job in jobs:
            if not job.done():
                job.cancel()
    if died:
        raise WorkerDied


def run_share(workers: Workers, share: Mapping[str, Work]) -> list[tuple[str, Any]]:
    """What one task of an array does."""
    done = shared_out(share.__getitem__, list(share), workers, found=_nothing, what="items")
    return list(done)


def _nothing(item: str) -> None:
    """A task of an array does not know where its work leaves what."""
