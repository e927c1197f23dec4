"""`gensp check` and `gensp repair`: what is wrong with meshes, and mending them."""

from pathlib import Path
from typing import Annotated

import typer


def check(
    files: Annotated[list[Path], typer.Argument(help="Meshes: ply, obj, off or stl.")],
    max_faces: Annotated[
        int | None,
        typer.Option(
            min=4, help="Larger meshes are refused; the limit of parameterize if not given."
        ),
    ] = None,
) -> None:
    """Say what is wrong with each mesh and what mends it.

    Counts boundary, non-manifold and misoriented edges, components, genus,
    degenerate and duplicate faces, duplicate vertices. Exit code 2 if any of
    the meshes cannot be used.
    """
    from gensp.cli.terminal import sections
    from gensp.errors import BadMesh
    from gensp.geometry.mesh import MAX_FACES

    found = [_checked(path, max_faces or MAX_FACES) for path in files]
    sections((str(path), lines) for path, (_, lines) in zip(files, found, strict=True))
    bad = [path for path, (usable, _) in zip(files, found, strict=True) if not usable]
    if bad:
        raise BadMesh(
            f"{', '.join(map(str, bad))}: {len(bad)} of {len(files)} meshes cannot be used; one "
            "closed surface of genus 0 is required; the list names the remedies"
        )


def _checked(path: Path, max_faces: int) -> tuple[bool, list[str]]:
    """Whether a mesh can be used, and the verdict with all findings."""
    from gensp.errors import BadMesh
    from gensp.geometry.diagnosis import diagnose, repair_command
    from gensp.geometry.mesh import load_mesh

    try:
        found = diagnose(load_mesh(path), max_faces=max_faces)
    except BadMesh as error:
        what, *_, remedy = str(error).removeprefix(f"{path}: ").split("; ")
        return False, ["unreadable", f"{what} → {remedy}"]
    size = f"{found.vertices} vertices, {found.faces} faces"
    if found.usable:
        seen = ", ".join(what for what, _ in found.findings) or "nothing"
        return True, [f"usable: {size}; found: {seen}"]
    findings = [f"{what} → {remedy}" for what, remedy in found.findings]
    return False, [f"not usable: {size}", *findings, f"type: {repair_command(path, found)}"]


def repair(
    mesh: Annotated[Path, typer.Argument(help="The mesh to mend.")],
    out: Annotated[Path, typer.Argument(help="The mended mesh: ply, obj, off or stl.")],
    remesh: Annotated[
        bool,
        typer.Option(
            "--remesh",
            help="New triangles around what the winding number calls inside: for soups, parts "
            "that pass through each other, and handles, which are closed.",
        ),
    ] = False,
    resolution: Annotated[
        int, typer.Option(min=16, max=512, help="With --remesh: cells along the longest side.")
    ] = 128,
    vertices: Annotated[
        int, typer.Option(min=100, help="With --remesh: about so many vertices.")
    ] = 5000,
    largest_hole: Annotated[
        float, typer.Option(min=0, help="Longest rim of a hole to fill, in diagonals of the mesh.")
    ] = 1.0,
) -> None:
    """Mend a mesh so that it can be parameterized, and report the change.

    Mends orientation, duplicate vertices and faces, faces without area,
    non-manifold edges, holes, and drops all parts but the largest. Nothing
    is written unless the result is sound.
    """
    from gensp.cli.inputs import require_other, require_place
    from gensp.cli.repair import mended, report, require_format, write

    require_other(mesh, out, by="what is mended", remedy="name another file")
    require_format(out)
    require_place(out)
    result = mended(
        mesh,
        out,
        remesh=remesh,
        resolution=resolution,
        vertices=vertices,
        largest_hole=largest_hole,
    )
    write(result.after, out)
    report(result, out)
