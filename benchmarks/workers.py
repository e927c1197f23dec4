"""What two processes gain over one on real items: maps or flows of a collection.

OMP_NUM_THREADS=1 python benchmarks/workers.py                    # maps of the quadrupeds
OMP_NUM_THREADS=1 python benchmarks/workers.py --work flows --count 20

Starting workers (imports, cached compiled loops) is measured apart, with items that do nothing.
Wall seconds are those of a quiet machine only. Processor seconds are not: "gain by processor" is
what several processes would gain if nothing else ran, the seconds of one process over those of the
busiest of them.
"""

import argparse
import os
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra import compose, initialize_config_dir
from rich.console import Console

from gensp.compute import Row, Task, run_items
from gensp.configuration import made
from gensp.methods.hierarchical import compile_loops
from gensp.sharing import Workers

ROOT = Path(__file__).parents[1]
STAGES = {"maps": ("stage=parameterize", "method=dirichlet"), "flows": ("stage=augment",)}


@dataclass(frozen=True)
class Timed:
    """A task that tells who did it, and the processor seconds it took; idle items only wake up."""

    task: Task

    def __call__(self, item: str) -> Row:
        """The row, with `process` and `processor`."""
        start = time.process_time()
        if item.startswith("idle"):
            compile_loops()
            time.sleep(0.5)
            row: Row = {"id": item}
        else:
            row = self.task(item)
        seconds = time.process_time() - start
        return row | {"process": os.getpid(), "processor": seconds}


def work_of(kind: str, shapes: str, folder: Path) -> tuple[Task, list[str]]:
    """The task and the items that the command line would have."""
    words = [f"shapes={shapes}", *STAGES[kind], f"paths.data={ROOT / 'data'}"]
    words += [f"paths.cache={folder / 'cache'}", "name=workers"]
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfg = compose("config", overrides=words)
    data = made(cfg.data, inputs={}, folder=folder)
    return data.task, list(data.items)


def measure(task: Task, items: Sequence[str], folder: Path, jobs: int) -> dict[str, float]:
    """Seconds of starting the workers, and of the items."""
    workers, began = Workers(jobs), time.perf_counter()
    idle = [f"idle{k}" for k in range(2 * jobs)]
    list(run_items(Timed(task), idle, folder / f"idle{jobs}", workers))
    started = time.perf_counter()
    rows = list(run_items(Timed(task), items, folder / f"items{jobs}", workers))
    wall = time.perf_counter() - started
    failed = [row for row in rows if row.get("error")]
    assert not failed, failed[:3]
    busy: Counter[int] = Counter()
    for row in rows:
        busy[int(row["process"])] += float(row["processor"])  # type: ignore[arg-type, assignment]
    return {
        "jobs": jobs,
        "start": started - began,
        "wall": wall,
        "processor": sum(busy.values()),
        "busiest": max(busy.values()),
    }


def main() -> None:
    """Print a table and the ratios of one process to the others."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", choices=STAGES, default="maps")
    parser.add_argument("--shapes", default="quadrupeds")
    parser.add_argument("--count", type=int, help="of the collection's shapes; default: all")
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    words = parser.parse_args()
    compile_loops()  # into the cache on the disk
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        task, items = work_of(words.work, words.shapes, folder)
        items = items[: words.count]
        found = [measure(task, items, folder, jobs) for jobs in words.jobs]
    show(found, f"{words.work} of {len(items)} shapes of {words.shapes}")


def show(found: Sequence[dict[str, float]], title: str) -> None:
    """A Markdown table."""
    head = ("jobs", "start", "items, wall", "items, processor", "busiest process")
    head = (*head, "gain", "gain by processor")
    lines = [title, "", f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    first = found[0]
    for row in found:
        gains = (first["wall"] / row["wall"], first["processor"] / row["busiest"])
        cells = [f"{row[key]:.2f}" for key in ("start", "wall", "processor", "busiest")]
        cells += [f"{gain:.2f}" for gain in gains]
        lines.append(f"| {row['jobs']} | {' | '.join(cells)} |")
    load = os.getloadavg()[0]
    lines += ["", f"Seconds; {os.cpu_count()} cores, load at the end {load:.1f}."]
    Console(width=200).print("\n".join(lines), markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
