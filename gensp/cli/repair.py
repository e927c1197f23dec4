"""The work of `gensp repair`: mend, require a sound mesh, compare with what was there."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path

from gensp.cli.terminal import progress, two_columns, written
from gensp.errors import BadMesh, NotGenusZero, Unsupported
from gensp.export.polygons import write_ply
from gensp.export.wavefront import write_obj
from gensp.geometry.diagnosis import Diagnosis, diagnose, enough
from gensp.geometry.distance import hausdorff
from gensp.geometry.mesh import FORMATS, MAX_FACES, Mesh, load_mesh, require_genus_zero, save_mesh
from gensp.geometry.repair import Repaired, bounding_diagonal, repair, sane


@dataclass(frozen=True)
class Mended:
    """A mesh before and after mending, and what was done."""

    before: Mesh
    after: Mesh
    steps: dict[str, str]


def mended(
    path: Path, out: Path, *, remesh: bool, resolution: int, vertices: int, largest_hole: float
) -> Mended:
    """Mend the mesh of a file; `out` is where it will be written, for what is told to type.

    Raises
    ------
    BadMesh
        It cannot be read, or the result is still not sound.
    """
    mesh = load_mesh(path)
    if remesh:
        return _remeshed(path, sane(mesh), resolution, vertices)
    found: Repaired = repair(mesh, largest_hole=largest_hole)
    most = max(MAX_FACES, len(mesh.faces))
    try:
        require_genus_zero(found.mesh, max_faces=most)
    except BadMesh as error:
        after = diagnose(found.mesh, max_faces=most)
        left = ", ".join(what for what, _ in after.findings) or str(error)
        words = shlex.join(["gensp", "repair", str(path), str(out), *_harder(after, largest_hole)])
        raise NotGenusZero(
            f"{path}: {left} left after mending; one closed surface of genus 0 is required; "
            f"type: {words}"
        ) from error
    steps = {step: str(count) for step, count in found.steps.items()}
    if found.dropped:
        steps["area of the dropped parts"] = f"{found.dropped:.1%} of all parts'"
    return Mended(mesh, found.mesh, steps)


def _harder(after: Diagnosis, largest_hole: float) -> list[str]:
    """Options that may mend what is left: larger holes first, new triangles last."""
    holes = after.longest_rim > largest_hole
    return ["--largest-hole", enough(after.longest_rim)] if holes else ["--remesh"]


def _remeshed(path: Path, mesh: Mesh, resolution: int, vertices: int) -> Mended:
    from gensp.geometry.solid import solid_surface

    with progress(mesh.name):
        solid = solid_surface(mesh, resolution=resolution, vertices=vertices)
    require_genus_zero(solid.mesh, max_faces=max(MAX_FACES, len(solid.mesh.faces)))
    steps = {"remeshed on a grid of": f"{resolution} cells"}
    if solid.radius:
        steps["handles closed by a ball of"] = f"{solid.radius:g} diagonals"
    return Mended(mesh, replace(solid.mesh, name=path.stem), steps)


def write(mesh: Mesh, path: Path) -> None:
    """Write a mended mesh, ply and obj with all digits.

    Raises
    ------
    Unsupported
        The suffix names no format of meshes.
    """
    require_format(path)
    end = path.suffix.lower()
    if end == ".obj":
        write_obj(path, mesh.vertices, mesh.faces)
    elif end == ".ply":
        write_ply(path, mesh)
    else:
        save_mesh(mesh, path)


def require_format(path: Path) -> None:
    """Refuse a name whose suffix is that of no format of meshes.

    Raises
    ------
    Unsupported
        Another suffix, or a folder.
    """
    if path.suffix.lower() not in FORMATS:
        what = "is a folder" if path.is_dir() else f"format '{path.suffix}' is not written"
        raise Unsupported(
            f"{path}: {what}; one of {', '.join(FORMATS)} is required; name another file"
        )


def report(result: Mended, path: Path) -> None:
    """Print what was done, and how far the surface moved."""
    before, after = diagnose(result.before), diagnose(result.after)
    old = sane(result.before)
    far = hausdorff(old, result.after) / bounding_diagonal(old)
    rows = [
        *result.steps.items(),
        ("vertices", f"{before.vertices} → {after.vertices}"),
        ("faces", f"{before.faces} → {after.faces}"),
        ("components", f"{before.components} → {after.components}"),
        ("boundary edges", f"{before.boundary_edges} → {after.boundary_edges}"),
        ("non-manifold edges", f"{before.nonmanifold_edges} → {after.nonmanifold_edges}"),
        ("genus", f"{_genus(before)} → {_genus(after)}"),
        ("area", f"{old.area:.4g} → {result.after.area:.4g}"),
        ("Hausdorff distance", f"{far:.3g} of the diagonal"),
        written([path]),
    ]
    two_columns(str(path.name), rows)


def _genus(found: Diagnosis) -> str:
    return "–" if found.genus is None else str(found.genus)
