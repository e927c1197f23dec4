"""`gensp card`: the data card of a collection."""

from pathlib import Path
from typing import Annotated

import typer

from gensp.cli.options import Up, checked_axis


def card(
    folder: Annotated[Path, typer.Argument(help="A collection: a folder of meshes.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the card; the collection's own without it.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Its name; that of the folder without it.")
    ] = None,
    up: Up = "y",
    shown: Annotated[int, typer.Option(min=1, max=200, help="So many meshes are drawn.")] = 24,
) -> None:
    """Write CARD.md and card.jpg: counts, genus, sizes, licences, splits.

    Reads manifest.csv, corr/ and keypoints.json where they are, and what
    stage=prepare has left.
    """
    from gensp.card import write_card
    from gensp.cli.inputs import require_folder
    from gensp.cli.terminal import two_columns, written

    checked_axis(up)
    if out is not None:
        require_folder(out)
    paths = write_card(folder, name=name, up=up, out=out, shown=shown)
    two_columns(folder.name, [written(paths)])
