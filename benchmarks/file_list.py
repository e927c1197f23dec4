"""What the list of a stage's files costs: processor seconds and memory, by the number of files.

OMP_NUM_THREADS=1 python benchmarks/file_list.py --files 1000 30000 100000 --out FOLDER

For each number a stage's folder is made, of files of 8 bytes in the folders that `gensp.layout`
gives them; the list is written, the digest of the results is taken from it, and every file is
compared with it, each by a process of its own. Prints a table.
"""

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from gensp.checksums import MANIFEST, digest_of, listed, require_intact, write_list
from gensp.files import read_json, write_json
from gensp.layout import item_folder, lay_out
from gensp.machine import forget_peak_memory, peak_memory

STEPS = ("write", "digest", "compare")


def fill(folder: Path, files: int) -> None:
    """A folder of so many small files."""
    lay_out(folder, files)
    for k in range(files):
        path = item_folder(folder, "maps", f"shape{k}") / f"shape{k}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(k.to_bytes(8))


def step(name: str, folder: Path) -> None:
    """One step; prints its processor seconds and how much its memory grew, in MiB."""
    work: dict[str, Callable[[], object]] = {
        "write": lambda: write_json(folder / MANIFEST, write_list(folder)),
        "digest": lambda: digest_of(listed(folder, read_json(folder / MANIFEST))),
        "compare": lambda: require_intact(
            folder, listed(folder, read_json(folder / MANIFEST)), "augment"
        ),
    }
    forget_peak_memory()
    before, began = peak_memory(), time.process_time()
    work[name]()
    seconds, grown = time.process_time() - began, peak_memory() - before
    print(f"{seconds:.2f} {1024 * grown:.1f}")  # noqa: T201


def row(out: Path, files: int) -> str:
    """The line of the table of so many files."""
    folder = out / f"files-{files}"
    fill(folder, files)
    cells = [f"{files:,}"]
    for name in STEPS:
        command = [sys.executable, __file__, "--out", str(folder), "--step", name]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        seconds, memory = done.stdout.split()
        cells += [seconds, memory]
    shutil.rmtree(folder)
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Read the command line, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--files", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--step", choices=STEPS, help="one step in the folder out; for itself")
    words = parser.parse_args()
    if words.step:
        step(words.step, words.out)
        return
    heads = [f"{name} ({unit})" for name in STEPS for unit in ("s", "MiB")]
    print(f"| files | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")  # noqa: T201
    for files in words.files:
        print(row(words.out, files), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
