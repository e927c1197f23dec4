"""All speed figures that the project promises, each beside its target.

OMP_NUM_THREADS=1 python benchmarks/speed.py [names]     # prints a Markdown table
"""

import argparse
import importlib
import os
import platform

from rich.console import Console
from rich.progress import track

BENCHMARKS = ("cmcf", "closest_point", "registration", "rotation", "newton", "regularizer")


def markdown(rows: list[dict[str, object]]) -> str:
    """The table, headed by the machine that it was measured on."""
    machine = f"{os.cpu_count()} × {processor()}, Python {platform.python_version()}"
    lines = [f"Measured on {machine}.", "", "| what | figure | target |", "|---|---|---|"]
    lines += [
        f"| {row['name']} | {row['figure']:.3g} {row['unit']} | {row['required']} |"
        for row in rows
    ]
    return "\n".join(lines)


def processor() -> str:
    """The processor's name where the system tells it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":")[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.machine()


def main() -> None:
    """Measure one after the other, in this process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(BENCHMARKS)}; none: all")
    names = parser.parse_args().names
    if unknown := set(names) - set(BENCHMARKS):
        parser.error(f"{', '.join(sorted(unknown))}: one of {', '.join(BENCHMARKS)} is required")
    rows: list[dict[str, object]] = []
    progress = Console(stderr=True)
    for name in track(names or list(BENCHMARKS), "measuring", console=progress):
        rows += importlib.import_module(name).measure()
    Console(width=200).print(markdown(rows), markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
