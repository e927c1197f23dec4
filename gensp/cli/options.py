"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[Path, typer.Option(help="Folder for the files.")]
Method = Annotated[
    str | None,
    typer.Option(
        help="Method for a mesh: dirichlet (default), stretch, ahsp, smat, cmcf, all without "
        "folds; arap, vc25, cmcf_raw may fold. None is trained."
    ),
]
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        "--checkpoint",
        help="Use GenSP instead of a --method, with a model of the package (heads, quadrupeds, "
        "humans) or a model.pt.",
    ),
]
Register = Annotated[
    bool,
    typer.Option(
        "--register",
        help="With --model: register the generated surface to the shape first. For shapes "
        "that a model.pt has never seen; models of the package do what they need by themselves.",
    ),
]
Align = Annotated[
    bool | None,
    typer.Option(
        "--align/--no-align",
        help="Rotate the first sphere so that the shapes agree. Without this option: for meshes "
        "that are parameterized here by a method, not for maps or a model's.",
        show_default=False,
    ),
]
Up = Annotated[str, typer.Option(help="Axis that points up: x, y, z, -x, -y or -z.")]


def checked_axis(up: str) -> None:
    """Refuse what is no axis.

    Raises
    ------
    typer.BadParameter
        Anything but x, y, z with or without a minus sign.
    """
    if up not in ("x", "y", "z", "-x", "-y", "-z"):
        raise typer.BadParameter(f"--up {up}: one of x, y, z, -x, -y, -z is required")
