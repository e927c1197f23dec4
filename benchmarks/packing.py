"""What the list of shapes costs that travels to the workers with the items of a stage.

    python benchmarks/packing.py --shapes 10000 100000

Two workers do items that take no time, of a task that holds a collection of so many shapes: packed
with every item, and once (`gensp.sharing.Packed`, as stages do). Wall-clock seconds that an item
takes more, from 12 to 36 items.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gensp.data.folder import Shape
from gensp.sharing import Packed, Workers, WorkOf, shared_out

FEW, MANY = 12, 36


@dataclass(frozen=True)
class Task:
    """Does nothing, with all shapes at hand."""

    shapes: tuple[Shape, ...]

    def __call__(self, item: str) -> int:
        """How many there are."""
        return len(self.shapes)


def seconds(work: WorkOf, count: int) -> float:
    """Seconds for so many items."""
    items = [f"item {number}" for number in range(count)]
    began = time.perf_counter()
    done = dict(shared_out(work, items, Workers(2), found=lambda item: None, what="benchmark"))
    assert len(done) == count
    return time.perf_counter() - began


def main() -> None:
    """Print a row for every number of shapes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shapes", type=int, nargs="+", default=(10_000, 100_000))
    sys.stdout.write("| shapes | with every item | once |\n|--:|--:|--:|\n")
    for count in parser.parse_args().shapes:
        names = (f"shape{number:07d}" for number in range(count))
        task = Task(tuple(Shape(name, Path(f"meshes/{name}.ply")) for name in names))
        figures = []
        for carried in (task, Packed(task)):
            work = partial(partial, carried)
            few = seconds(work, FEW)
            figures.append(max(seconds(work, MANY) - few, 0.0) / (MANY - FEW))
        sys.stdout.write(f"| {count:,} | {' | '.join(f'{f:.3f} s' for f in figures)} |\n")


if __name__ == "__main__":
    main()
