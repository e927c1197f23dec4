"""`gensp runs`: finished runs listed, shown, compared and exported."""

from pathlib import Path
from typing import Annotated

import typer

runs = typer.Typer(
    help="Finished runs of 'python train.py': list, show, compare, export. A folder may be that "
    "of a stage, a variant, an experiment, or of all runs."
)
Root = Annotated[Path, typer.Argument(help="Folder of runs.")]


@runs.command("list")
def list_(root: Root = Path("runs")) -> None:
    """A row for every finished stage: headline, seconds, memory, revision."""
    from gensp.catalogue import LISTED, find_runs, listed
    from gensp.cli.terminal import show_table

    show_table("", LISTED, listed(find_runs(root)))


@runs.command()
def show(root: Annotated[Path, typer.Argument(help="Folder of one stage.")]) -> None:
    """Everything that the manifest of a stage tells."""
    from gensp.catalogue import find_runs, text
    from gensp.cli.terminal import two_columns

    for entry in find_runs(root):
        files = f"{entry.files} files, {entry.size / 2**20:.1f} MiB"
        told = {**entry.facts, "wrote": files, **entry.metrics, **entry.settings}
        two_columns(entry.name, [(key, text(value)) for key, value in told.items()])


@runs.command()
def compare(
    folders: Annotated[list[Path], typer.Argument(help="Two or more stages, variants or more.")],
) -> None:
    """What differs: settings, versions, hardware, metrics; seconds and memory always."""
    from gensp.catalogue import compared, find_runs
    from gensp.cli.terminal import show_table

    rows = compared([find_runs(folder) for folder in folders])
    show_table("", ["stage", "key", *map(str, folders)], rows)


@runs.command("export")
def export_(
    root: Root,
    out: Annotated[Path, typer.Argument(help="File: .csv and .json tell all, .md the list.")],
) -> None:
    """Write all runs of a folder as one table."""
    from gensp.catalogue import export, find_runs
    from gensp.cli.inputs import require_place
    from gensp.cli.terminal import two_columns, written

    require_place(out)
    entries = find_runs(root)
    export(entries, out)
    two_columns(out.name, [("runs", str(len(entries))), written([out])])
