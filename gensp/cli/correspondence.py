"""`gensp match` and `gensp transfer`: from one shape to another through the sphere."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gensp.cli.options import Align, Method, Model, Out, Register

if TYPE_CHECKING:
    import numpy as np

    from gensp.cli.pairs import Pair
    from gensp.geometry.matching import Matching


def match(
    a: Annotated[Path, typer.Argument(help="A map (npz), or a mesh.")],
    b: Annotated[Path, typer.Argument(help="Another.")],
    out: Out = Path("."),
    align: Align = None,
    method: Method = None,
    model: Model = None,
    register: Register = False,
) -> None:
    """Say where every vertex of each shape lies on the other.

    Writes <a>_to_<b>.npz and .csv, and the same from b to a: face,
    barycentric weights, position, and a reliability in [0, 1]: 1 where the
    surroundings of the vertex keep their size and shape, less where not.
    """
    from gensp.cli.inputs import require_folder
    from gensp.cli.pairs import pair_of, tell_apart
    from gensp.cli.terminal import two_columns, written
    from gensp.geometry.matching import matching

    require_folder(out)
    pair = pair_of(a, b, method=method, model=model, register=register, align=align)
    known = (pair.a.arrays.get("reliability"), pair.b.arrays.get("reliability"))
    first, second = pair.names
    there = matching(pair.a, pair.b, pair.rotation, weights=known)
    back = matching(pair.b, pair.a, pair.rotation.T, weights=known[::-1])
    paths = _write(there, pair, out / f"{first}_to_{second}")
    paths += _write(back, pair, out / f"{second}_to_{first}")
    rows = [
        (f"{name}: reliability", _spread(found.reliability))
        for name, found in ((f"{first} → {second}", there), (f"{second} → {first}", back))
    ]
    two_columns(f"{first} and {second}", [*rows, written(paths)])
    tell_apart(pair)


def _spread(values: "np.ndarray") -> str:
    import numpy as np

    return f"mean {values.mean():.2f}, a tenth below {np.quantile(values, 0.1):.2f}"


def _write(found: "Matching", pair: "Pair", stem: Path) -> list[Path]:
    from gensp.export.correspondence import write_matching

    return write_matching(found, stem, rotation=pair.rotation)


def transfer(
    source: Annotated[Path, typer.Argument(help="Map (npz), or mesh, of the shape that has it.")],
    target: Annotated[Path, typer.Argument(help="Map (npz), or mesh, of the shape that gets it.")],
    out: Annotated[Path, typer.Option(help="npz, ply (colours), or stem of a textured mesh.")],
    attribute: Annotated[
        str | None,
        typer.Option(help="FILE.npz:NAME with a row a vertex, or a PLY with vertex colours."),
    ] = None,
    texture: Annotated[
        Path | None,
        typer.Option(help="OBJ or GLB of the source with texture coordinates and a picture."),
    ] = None,
    height: Annotated[
        int, typer.Option(min=16, max=4096, help="Height of the baked picture in pixels.")
    ] = 1024,
    align: Align = None,
) -> None:
    """Carry colours, numbers or a texture from one shape to another through the sphere.

    Floats and colours are interpolated, integers are labels. A texture is
    baked into one picture of the sphere, which the target wears: OUT.glb,
    OUT.obj, OUT.mtl, OUT.png.
    """
    from gensp.cli.inputs import require_folder, require_place
    from gensp.cli.pairs import pair_of, tell_apart
    from gensp.cli.terminal import two_columns, written
    from gensp.cli.transfer import require_one, transfer_attribute, transfer_texture

    require_one(attribute, texture)
    if texture is not None:
        require_folder(out.parent)
        pair = pair_of(source, target, align=align)
        rows = [written(transfer_texture(pair, texture, out, height))]
    else:
        require_place(out)
        pair = pair_of(source, target, align=align)
        rows = transfer_attribute(pair, str(attribute), out)
    two_columns(f"{pair.a.name} → {pair.b.name}", rows)
    tell_apart(pair)
