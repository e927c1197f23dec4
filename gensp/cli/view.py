"""`gensp view`: a page on which a shape and its sphere turn."""

from pathlib import Path
from typing import Annotated

import typer


def view(
    map: Annotated[Path, typer.Argument(help="A map (npz) of gensp parameterize.")],
    out: Annotated[
        Path | None, typer.Option(help="The page; beside the map, <stem>.html, if not given.")
    ] = None,
    open: Annotated[bool, typer.Option("--open/--no-open", help="Open it in a browser.")] = True,
    up: Annotated[str, typer.Option(help="Axis that points up: x, y, z or -x, -y, -z.")] = "y",
) -> None:
    """Write a page, which needs no network, where shape and sphere turn in one texture."""
    from gensp.cli.inputs import read_map
    from gensp.cli.morph import _axis
    from gensp.cli.terminal import two_columns, written
    from gensp.cli.view_page import write_page

    found = read_map(map)
    page = write_page(found, out or map.with_suffix(".html"), _axis(up))
    two_columns(found.name, [("certificate", str(found.certify())), written([page])])
    if open:
        typer.launch(str(page.resolve()))
