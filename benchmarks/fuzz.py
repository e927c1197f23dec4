"""Damaged and hostile files against every reader: our own errors only, bounded time and memory.

OMP_NUM_THREADS=1 python benchmarks/fuzz.py --inputs 10000 --out fuzz   # shared by the readers
OMP_NUM_THREADS=1 python benchmarks/fuzz.py --readers npz-map --inputs 500

Valid files are written by the repository's own writers and mutated, by a seed. Fails where a
reader raises another error, dies, takes longer than 20 s or a GiB more than before.
"""

import argparse
import csv
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

import numpy as np
from fuzz_mutations import mutated
from fuzz_readers import READERS, Reader
from rich.console import Console

from gensp.errors import GenSPError

LONGEST = 20.0  # seconds
LARGEST = 2**30  # bytes of resident memory beyond those before the first input
_ADDRESSES = 4 * 2**30  # bytes that a reader may ask for
_SAY = Console(stderr=True)


class TooSlow(BaseException):
    """An input took longer than `LONGEST`; no reader catches it."""


@dataclass
class Tally:
    """What became of the inputs of one reader."""

    reader: str
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    other: int = 0
    slowest: float = 0.0
    memory: float = 0.0
    found: list[str] = field(default_factory=list)

    def add(self, number: int, verdict: str, seconds: float, memory: float) -> None:
        """Count one input; `verdict` is accepted, refused, or what went wrong."""
        self.inputs += 1
        self.accepted += verdict == "accepted"
        self.refused += verdict == "refused"
        self.slowest = max(self.slowest, seconds)
        self.memory = max(self.memory, memory)
        if memory > LARGEST / 2**20 and verdict in ("accepted", "refused"):
            verdict = f"{memory:.0f} MiB"
        if verdict not in ("accepted", "refused"):
            self.other += 1
            self.found.append(f"{self.reader} {number}: {verdict}")

    def cells(self) -> list[str]:
        """A line of the table."""
        counts = (self.inputs, self.accepted, self.refused, self.other)
        return [self.reader, *map(str, counts), f"{self.slowest:.2f}", f"{self.memory:.0f}"]


HEAD = ("reader", "inputs", "accepted", "refused", "other", "slowest (s)", "memory (MiB)")


def verdict(reader: Reader, path: Path) -> str:
    """Read one file: accepted, refused with an error of ours, or the error that came instead."""
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(path)
    except GenSPError as error:
        return "refused" if str(error) else "an error without words"
    except (Exception, TooSlow) as error:
        places = traceback.extract_tb(error.__traceback__)
        last = "; ".join(f"{Path(place.filename).name}:{place.lineno}" for place in places[-3:])
        return f"{type(error).__name__}: {str(error)[:100]} ({last})"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "accepted"


def work(reader: Reader, folder: Path, seed: int, numbers: range, results: Connection) -> None:
    """Mutate and read, in a process of its own, and tell of each input."""
    signal.signal(signal.SIGALRM, _stop)
    _limit_memory()
    valid = reader.write(folder)
    for path in valid:
        reader.read(path)
    contents = {path: path.read_bytes() for path in valid}
    before = _resident()
    for number in numbers:
        random = np.random.default_rng([seed, *reader.name.encode(), number])
        path = valid[number % len(valid)]
        path.write_bytes(mutated(contents[path], random))
        began = time.perf_counter()
        outcome = verdict(reader, path)
        seconds = time.perf_counter() - began
        results.send((number, outcome, seconds, (_resident() - before) / 2**20))
        path.write_bytes(contents[path])


def _stop(signum: int, frame: FrameType | None) -> None:
    raise TooSlow(f"longer than {LONGEST:g} s")


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + _ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _resident() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def told(reader: Reader, seed: int, count: int) -> Iterator[tuple[int, str, float, float]]:
    """Outcomes of `count` inputs; a process that dies or hangs is one, and the next goes on."""
    context = multiprocessing.get_context("fork")
    done = 0
    while done < count:
        ours, theirs = context.Pipe(duplex=False)
        with tempfile.TemporaryDirectory(prefix="gensp-fuzz-") as folder:
            words = (reader, Path(folder), seed, range(done, count), theirs)
            process = context.Process(target=work, args=words)
            process.start()
            theirs.close()
            try:
                while done < count and ours.poll(3 * LONGEST):
                    yield ours.recv()
                    done += 1
            except EOFError:
                pass
            if done < count:
                process.kill()
                process.join()
                yield done, f"the process ended with {process.exitcode}", 0.0, 0.0
                done += 1
            process.join()


def tally(reader: Reader, seed: int, count: int) -> Tally:
    """Count the outcomes of one reader."""
    result = Tally(reader.name)
    for outcome in told(reader, seed, count):
        result.add(*outcome)
    _SAY.print(" ".join(result.cells()), highlight=False)
    for line in result.found[:5]:
        _SAY.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)
    return result


def markdown(tallies: Sequence[Tally]) -> str:
    """The table, with a line for all readers together."""
    total = Tally("all")
    for entry in tallies:
        for name in ("inputs", "accepted", "refused", "other"):
            setattr(total, name, getattr(total, name) + getattr(entry, name))
        total.slowest = max(total.slowest, entry.slowest)
        total.memory = max(total.memory, entry.memory)
    rows = [HEAD, ["---"] * len(HEAD), *(entry.cells() for entry in (*tallies, total))]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Fuzz the readers, print the table."""
    names = {reader.name: reader for reader in READERS}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--readers", nargs="+", default=list(names), choices=names)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    share = -(-chosen.inputs // len(chosen.readers))
    tallies = [tally(names[name], chosen.seed, share) for name in chosen.readers]
    Console(width=200).print(markdown(tallies), markup=False, highlight=False, soft_wrap=True)
    if chosen.out:
        _write(chosen.out, tallies)
    wrong = [line for entry in tallies for line in entry.found]
    if wrong:
        sys.exit("\n".join(wrong[:100]))


def _write(folder: Path, tallies: Sequence[Tally]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fuzz.md").write_text(markdown(tallies) + "\n", encoding="utf-8")
    with open(folder / "fuzz.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([HEAD, *(entry.cells() for entry in tallies)])


if __name__ == "__main__":
    main()
