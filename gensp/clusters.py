"""Items on many machines by dask and ray, each an extra of the package.

The run folder must be the same folder on all of them: a worker writes the files of its items.
"""

import importlib
import logging
import os
import socket
import uuid
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any
from urllib.parse import urlsplit

from gensp.errors import GenSPError, MissingData
from gensp.sharing import Found, Pool, WorkerDied, Workers, WorkOf

_PATIENCE = 10  # seconds in which a scheduler must answer

# What these log of a lost connection is said here in one line.
_TALKATIVE = ("distributed.client", "distributed.core", "tornado.application")


def needed(module: str, extra: str) -> Any:
    """A library that only some installations have.

    Raises
    ------
    MissingData
        It is not there; the message tells how to get it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise MissingData(
            f"compute={extra}: the package '{error.name}' is not installed; it is required; "
            f"type: pip install 'gensp[{extra}]'"
        ) from None


def require_answer(address: str, compute: str, start: str) -> None:
    """Knock at a scheduler, for some libraries wait for minutes.

    Raises
    ------
    GenSPError
        Nothing answers there.
    """
    place = urlsplit(address if "//" in address else f"//{address}")
    try:
        host, port = place.hostname, place.port
        if host is None or port is None:
            raise ValueError("host and port are required")
        socket.create_connection((host, port), timeout=_PATIENCE).close()
    except (OSError, ValueError) as error:
        raise GenSPError(
            f"compute={compute}: no scheduler was found at {address} ({error}); start one with "
            f"'{start}' and set workers.address=HOST:PORT, or leave workers.address out to use "
            "this machine"
        ) from None


@dataclass(frozen=True)
class ClusterWorkers(Workers):
    """Workers of a cluster that is reached over the network.

    Attributes
    ----------
    address
        Of a scheduler that runs; none: a cluster of this machine's processes for as long as there
        is something to do.
    jobs
        Items at once; 0: as many as the cluster has cores.
    """

    address: str | None = None

    def count(self, ranks: int = 1) -> int:
        """Of a scheduler elsewhere the ranks take their share too, of all its cores for 0."""
        if self.address is None:
            return super().count(ranks)
        return max(1, (self.jobs or self._known_cores()) // ranks)

    def _known_cores(self) -> int:
        cores = self._cores()
        if not cores:
            raise GenSPError(
                f"{self.address}: the scheduler has no workers; one at least is required; start "
                "some, or set workers.jobs=N to wait for them"
            )
        return cores

    @abstractmethod
    def _cores(self) -> int:
        """Cores of the cluster at `address`."""


class DaskWorkers(ClusterWorkers):
    """Workers of dask.distributed."""

    def _cores(self) -> int:
        with self._client(0) as client:
            return sum(client.nthreads().values())

    @contextmanager
    def _client(self, count: int) -> Iterator[Any]:
        distributed = needed("distributed", "dask")
        with ExitStack() as stack:
            stack.enter_context(_silenced(*_TALKATIVE))
            if self.address is not None:
                require_answer(self.address, "dask", "dask scheduler")
                place: Any = self.address if "//" in self.address else f"tcp://{self.address}"
            else:
                place = stack.enter_context(_own_dask(distributed, count))
            yield stack.enter_context(distributed.Client(place, timeout=_PATIENCE))

    @contextmanager
    def pool(self, work: WorkOf, count: int, found: Found) -> Iterator[Pool]:
        """Futures of a client; dask tells which item a worker died of."""
        distributed = needed("distributed", "dask")
        with self._client(count) as client, _carried(distributed, client, work) as key:

            def begin(item: str) -> Any:
                return client.submit(_done_by, key, item, pure=False)

            def first(futures: Sequence[Any]) -> Any:
                ended = distributed.wait(futures, return_when="FIRST_COMPLETED").done
                return next(iter(ended))

            def result(future: Any) -> Any:
                return future.result()

            try:
                yield partial(_by_futures, begin, first, result, distributed.KilledWorker)
            except CancelledError:
                raise GenSPError(
                    f"{client.scheduler.address}: compute=dask: the scheduler was lost; start it "
                    "again and run the same command to go on"
                ) from None


# What is carried to a worker of dask, in its process.
_CARRIED: dict[str, WorkOf] = {}


@contextmanager
def _carried(distributed: Any, client: Any, work: WorkOf) -> Iterator[str]:
    """Bring work to every worker once, and to those that take the place of dead ones; its key.

    Data that were scattered would be lost with their workers, and with them what depends on them.
    """
    key = uuid.uuid4().hex

    class Carrier(distributed.WorkerPlugin):
        def setup(self, worker: Any) -> None:
            _carry(key, work)

        def teardown(self, worker: Any) -> None:
            _drop(key)

    client.register_plugin(Carrier(), name=key)
    try:
        yield key
    finally:
        if client.status == "running":  # else the scheduler was lost
            client.unregister_worker_plugin(key)


def _carry(key: str, work: WorkOf) -> None:
    _CARRIED[key] = work


def _drop(key: str) -> None:
    _CARRIED.pop(key, None)


def _done_by(key: str, item: str) -> Any:
    return _done(_CARRIED[key], item)


@contextmanager
def _silenced(*names: str) -> Iterator[None]:
    """Loggers that say nothing meanwhile, and as much as before afterwards."""
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def _own_dask(distributed: Any, count: int) -> Iterator[Any]:
    dask = importlib.import_module("dask")
    # A task whose worker died is handed back: `shared_out` decides what is done again, and when.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        yield cluster


class RayWorkers(ClusterWorkers):
    """Workers of ray."""

    def _cores(self) -> int:
        with self._ray(0) as ray:
            return int(ray.cluster_resources().get("CPU", 0))

    @contextmanager
    def _ray(self, count: int) -> Iterator[Any]:
        # Without a word on what ray sends home.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        ray = needed("ray", "ray")
        # "local" is a new one, also where another runs on this machine.
        where: dict[str, Any] = {"address": "local", "num_cpus": count, "include_dashboard": False}
        if self.address is not None:
            require_answer(self.address, "ray", "ray start --head")
            where = {"address": self.address}
        ray.init(**where, log_to_driver=False, logging_level="CRITICAL", configure_logging=False)
        try:
            yield ray
        finally:
            ray.shutdown()

    @contextmanager
    def pool(self, work: WorkOf, count: int, found: Found) -> Iterator[Pool]:
        """Tasks of ray, each on a core of its own; ray does not repeat them."""
        with self._ray(count) as ray:
            remote = ray.remote(max_retries=0, num_cpus=1)(_done)
            sent = ray.put(work)

            def begin(item: str) -> Any:
                return remote.remote(sent, item)

            def first(futures: Sequence[Any]) -> Any:
                return ray.wait(list(futures))[0][0]

            died = (
                *(ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError),
                ray.exceptions.NodeDiedError,
            )
            yield partial(_by_futures, begin, first, partial(_result_of_ray, ray), died)


def _done(work: WorkOf, item: str) -> Any:
    return work(item)()


def _result_of_ray(ray: Any, future: Any) -> Any:
    try:
        return ray.get(future)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None


def _by_futures(
    begin: Callable[[str], Any],
    first: Callable[[Sequence[Any]], Any],
    result: Callable[[Any], Any],
    died: type[Exception] | tuple[type[Exception], ...],
    items: Sequence[str],
    count: int,
) -> Iterator[tuple[str, Any]]:
    """At most `count` futures at a time, so that as many items need memory."""
    waiting, suspects = iter(items), []
    running = {begin(item): item for item in islice(waiting, count)}
    while running:
        future = first(list(running))
        item = running.pop(future)
        running |= {begin(other): other for other in islice(waiting, 1)}
        try:
            ended = result(future)
        except died:
            suspects.append(item)
        else:
            yield item, ended
    if suspects:
        raise WorkerDied(suspects)
