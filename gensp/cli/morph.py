"""`gensp morph`: one shape becomes another, on common triangles."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gensp.cli.options import Align, Method, Model, Out, Register, Up, checked_axis

if TYPE_CHECKING:
    from gensp.geometry.mesh import Mesh


def morph(
    a: Annotated[Path, typer.Argument(help="A map (npz), or a mesh.")],
    b: Annotated[Path, typer.Argument(help="Another.")],
    out: Out = Path("."),
    frames: Annotated[int, typer.Option(min=2, max=999, help="Meshes, both ends included.")] = 9,
    icosphere: Annotated[int, typer.Option(min=2, max=7, help="Level of the triangles.")] = 5,
    up: Up = "y",
    align: Align = None,
    method: Method = None,
    model: Model = None,
    register: Register = False,
) -> None:
    """Write meshes that lead from one shape to another, all with the icosphere's triangles.

    Writes <a>_<b>_000.ply, … and a strip of pictures in the sphere's
    texture, <a>_<b>.png.
    """
    from gensp.cli.inputs import require_folder
    from gensp.cli.pairs import pair_of, tell_apart
    from gensp.cli.terminal import two_columns, written
    from gensp.export.polygons import write_ply
    from gensp.geometry.morph import morphed

    checked_axis(up)
    require_folder(out)
    pair = pair_of(a, b, method=method, model=model, register=register, align=align)
    stem = "_".join(pair.names)
    meshes = morphed(pair.a, pair.b, frames, level=icosphere, rotation=pair.rotation)
    paths = [out / f"{stem}_{k:03d}.ply" for k in range(frames)]
    for mesh, path in zip(meshes, paths, strict=True):
        write_ply(path, mesh)
    strip = _write_strip(meshes, icosphere, up, out / f"{stem}.png")
    two_columns(stem, [written([paths[0], Path("…"), paths[-1], strip])])
    tell_apart(pair)


def _write_strip(meshes: list["Mesh"], level: int, up: str, path: Path) -> Path:
    from gensp.geometry.sphere import icosphere
    from gensp.pictures.montage import Tile, rows_of, save_png
    from gensp.pictures.render import Scene, look

    ball, size = icosphere(level).vertices, 300
    view = look(up).fitted(*(mesh.vertices for mesh in meshes))
    tiles = [Tile(Scene(mesh, view, size, closed=True).textured(ball)) for mesh in meshes]
    return save_png(rows_of([tiles]), path)
