"""What the commands say: rich tables on stdout."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

EVERY = 10.0  # seconds between lines on progress


def two_columns(title: str, rows: Iterable[tuple[str, str]]) -> None:
    """A table of names and values."""
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    Console().print(table)


def show_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table with headings; for another program to read, unbroken lines with tabs."""
    console = Console()
    if not console.is_terminal:
        for row in (header, *rows):
            console.file.write("\t".join(row) + "\n")  # rich would make spaces of tabs
        return
    table = Table(title=title, title_justify="left", header_style="bold", show_lines=True)
    for heading in header:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)


def sections(parts: Iterable[tuple[str, Sequence[str]]]) -> None:
    """Headings with lines below; none is ever broken, so that file names can be copied."""
    console = Console(highlight=False)
    for heading, lines in parts:
        console.print(Text(heading, style="bold"), soft_wrap=True)
        for line in lines:
            console.print(Text(f"  {line}"), soft_wrap=True)


def written(paths: Iterable[Path]) -> tuple[str, str]:
    """A row that names files."""
    return "written", "\n".join(str(path) for path in paths)


def compile_announced() -> None:
    """Have the inner loops compiled before anything is timed; said on stderr where it takes long.

    The first call after an installation waits for the compiler; later ones read what it left.
    """
    from gensp.compiled import kept
    from gensp.methods.hierarchical import compile_loops

    first, console = not kept(), Console(stderr=True)
    if first:
        console.print("compiling the inner loops: once, some 20 seconds")
    seconds = compile_loops()
    if first:
        console.print(f"compiled in {seconds:.1f} s")


@contextmanager
def progress(name: str) -> Iterator[None]:
    """Show on stderr how far a map is: in place on a terminal, else a line every ten seconds."""
    from gensp.geometry.progress import listening

    console = Console(stderr=True, highlight=False)
    if console.is_terminal:
        with (
            console.status(name) as status,
            listening(lambda text: status.update(f"{name}: {text}")),
        ):
            yield
    else:
        with listening(_Lines(console, name)):
            yield


class _Lines:
    """What is told, as a line whenever ten seconds have gone by."""

    def __init__(self, console: Console, name: str) -> None:
        self.console, self.name, self.last = console, name, time.monotonic()

    def __call__(self, text: str) -> None:
        now = time.monotonic()
        if now - self.last >= EVERY:
            self.console.print(f"{self.name}: {text}", soft_wrap=True)
            self.last = now
