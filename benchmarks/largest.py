"""On how many shapes the largest σ of a method is at most that of another, and of all others.

    python benchmarks/largest.py RUNS/benchmark-heads

Every evaluation in the folder of an experiment counts whose maps have no bad face; the last column
is against all methods that learn nothing.
"""

import argparse
import csv
import sys
from pathlib import Path

from gensp.tables import markdown_table

Largest = dict[str, float]


def largest(table: Path) -> Largest:
    """The largest σ of every shape; nothing where a map has a bad face or is missing."""
    with open(table, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    sound = all(row["sigma_max"] and int(row["bad_faces"]) == 0 for row in rows)
    return {row["id"]: float(row["sigma_max"]) for row in rows} if sound else {}


def rows(found: dict[str, Largest]) -> list[list[str]]:
    """A row of every method: against each that learns nothing, and against the least of them."""
    plain = [name for name in found if not name.startswith("full")]
    return [
        [name, *(told(own, [found[n]]) for n in plain), told(own, [found[n] for n in plain])]
        for name, own in found.items()
    ]


def told(own: Largest, others: list[Largest]) -> str:
    """How many shapes have at most the least of the others."""
    least = {id: min(other[id] for other in others) for id in own}
    return f"{sum(own[id] <= least[id] for id in own)} of {len(own)}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("experiment", type=Path)
    folder = parser.parse_args().experiment
    tables = sorted(folder.glob("*/evaluate/shapes.csv"))
    found = {table.parts[-3]: table_of for table in tables if (table_of := largest(table))}
    if not found:
        sys.exit(f"{folder}: has no evaluation without bad faces; run experiment=benchmark first")
    ids = set.intersection(*(set(own) for own in found.values()))
    common = {name: {id: own[id] for id in ids} for name, own in found.items()}
    plain = [name for name in found if not name.startswith("full")]
    sys.stdout.write(markdown_table(["largest σ of", *plain, "all of these"], rows(common)))


if __name__ == "__main__":
    main()
