"""`gensp view`: a page on which a shape and its sphere turn."""

from pathlib import Path
from typing import Annotated

import typer

from gensp.cli.options import Up, checked_axis


def view(
    map: Annotated[Path, typer.Argument(help="A map (npz) of gensp parameterize.")],
    out: Annotated[
        Path | None, typer.Option(help="The page; beside the map, <stem>.html, if not given.")
    ] = None,
    open: Annotated[bool, typer.Option("--open/--no-open", help="Open it in a browser.")] = True,
    up: Up = "y",
) -> None:
    """Write a page, which needs no network, where shape and sphere turn in one texture."""
    from gensp.cli.inputs import read_map, require_place
    from gensp.cli.terminal import two_columns, written
    from gensp.cli.view_page import write_page

    checked_axis(up)
    page = out or map.with_suffix(".html")
    require_place(page)
    found = read_map(map)
    write_page(found, page, up)
    two_columns(found.name, [("certificate", str(found.certify())), written([page])])
    if open:
        typer.launch(str(page.resolve()))
