"""What the commands say: rich tables on stdout."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table


def two_columns(title: str, rows: Iterable[tuple[str, str]]) -> None:
    """A table of names and values."""
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    Console().print(table)


def show_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table with headings."""
    table = Table(title=title, title_justify="left", header_style="bold", show_lines=True)
    for heading in header:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def written(paths: Iterable[Path]) -> tuple[str, str]:
    """A row that names files."""
    return "written", "\n".join(str(path) for path in paths)


def tell_of_compiling() -> None:
    """One line on stderr before the first call ever, which waits for the compiler."""
    from gensp.compiled import kept

    if not kept():
        Console(stderr=True).print("compiling the inner loops: once, about half a minute")
