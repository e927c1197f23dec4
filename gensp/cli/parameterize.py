"""`gensp parameterize`: one mesh to the sphere, and what can be made of its map."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gensp.cli.options import Method, Model, Out, Register

if TYPE_CHECKING:
    from gensp.geometry.spherical_map import SphericalMap


def parameterize(
    mesh: Annotated[Path, typer.Argument(help="Closed genus-0 mesh: ply, obj, off or stl.")],
    out: Out = Path("."),
    method: Method = None,
    model: Model = None,
    register: Register = False,
    texture: Annotated[
        bool,
        typer.Option(
            "--texture",
            help="Write <stem>_textured.glb and .obj with .mtl, .png: a sphere texture.",
        ),
    ] = False,
    icosphere: Annotated[
        int | None,
        typer.Option(min=0, max=8, help="Write the shape on this icosphere."),
    ] = None,
    geometry_image: Annotated[
        int | None, typer.Option(min=3, max=4097, help="Write so large an octahedral image.")
    ] = None,
) -> None:
    """Map a mesh to the unit sphere, without folds, with a certificate.

    Writes <stem>.npz (vertices, faces, sphere), <stem>.ply (the same, with
    doubles px py pz) and <stem>_sphere.obj. Where a method that may fold has
    folded, only these are written, and the exit code is 2.
    """
    from gensp.cli.inputs import chosen_method, require_folder, sound_mesh
    from gensp.cli.terminal import compile_announced, progress, two_columns, written

    require_folder(out)
    found = chosen_method(method, model, register)
    surface = sound_mesh(mesh)
    _require_free(mesh, out / surface.name, texture, icosphere)
    compile_announced()
    began = time.perf_counter()
    with progress(surface.name):
        map = found(surface)
    seconds = time.perf_counter() - began
    paths = _write_map(map, out)
    if map.certify():
        paths += _write_derived(map, out, texture, icosphere, geometry_image)
    two_columns(map.name, [*_figures(map, seconds, found.name), written(paths)])
    _require_bijective(map)


def _require_free(mesh: Path, stem: Path, texture: bool, icosphere: int | None) -> None:
    """Refuse, before anything is computed, to write over meshes and arrays that are not ours."""
    from gensp.cli.earlier import require_earlier
    from gensp.cli.inputs import require_other

    ends = [".npz", ".ply", "_sphere.obj"]
    ends += ["_textured.obj"] if texture else []
    ends += [] if icosphere is None else [f"_icosphere{icosphere}{end}" for end in ends[:2]]
    written = [stem.parent / f"{stem.name}{end}" for end in ends]
    require_other(mesh, written[1], by="its map", remedy="add --out FOLDER")
    require_earlier(mesh, written)


def _require_bijective(map: "SphericalMap") -> None:
    from gensp.geometry.certificate import require_bijective
    from gensp.methods.table import DEFAULT

    require_bijective(map.mesh, map.sphere, remedy=f"use --method {DEFAULT}")


def _figures(map: "SphericalMap", seconds: float, method: str) -> list[tuple[str, str]]:
    found, measured = map.certify(), map.distortion()
    return [
        ("vertices, faces", f"{len(map.sphere)}, {len(map.faces)}"),
        ("certificate", str(found)),
        *_rung(map, method),
        ("isometric σ", f"mean {measured.mean:.3f}, max {measured.max:.3f}"),
        ("isometric σ by area", f"mean {measured.area_weighted_mean:.3f}"),
        ("conformal σ", f"mean {measured.conformal_mean:.3f}, max {measured.conformal_max:.3f}"),
        *_familiarity(map),
        ("seconds", f"{seconds:.2f}"),
    ]


def _rung(map: "SphericalMap", method: str) -> list[tuple[str, str]]:
    """From which rung of the ladder the map was refined, where its method has one."""
    from gensp.methods.refinement import HIERARCHICAL, RUNGS

    rung = map.diagnostics.get("rung")
    led = ", led by the prediction" if "predicted" in map.arrays and rung == HIERARCHICAL else ""
    found = [("rung", f"{rung}: {RUNGS[rung]}{led}")] if rung in RUNGS else []
    if map.diagnostics.get("converged") is False:
        found.append(("refinement", f"stopped before it converged: {_way_on(method)}"))
    return found


def _way_on(method: str) -> str:
    """What helps a map that stopped early: our method, or triangles that can be mapped."""
    from gensp.methods.table import DEFAULT

    if method != DEFAULT:
        return f"try --method {DEFAULT}"
    return "triangles are too thin; try gensp repair --remesh"


def _familiarity(map: "SphericalMap") -> list[tuple[str, str]]:
    """How much the shape is like those that a model learnt from."""
    if "far" not in map.diagnostics:
        return []
    from gensp.methods.familiarity import SIGNALS, told

    far = map.diagnostics["far"]
    near = ", ".join(told(name, map.diagnostics[name]) for name in SIGNALS)
    if not far:
        return [("shape", f"like those that the model knows: {near}")]
    said = f"far from what the model knows: {far}; its correspondences may be wrong"
    return [("shape", said)]


def _write_map(map: "SphericalMap", out: Path) -> list[Path]:
    from gensp.export.wavefront import write_obj
    from gensp.geometry.spherical_map import save_map

    save_map(map, out)
    sphere = out / f"{map.name}_sphere.obj"
    write_obj(sphere, map.sphere, map.faces)
    return [out / f"{map.name}.npz", out / f"{map.name}.ply", sphere]


def _write_derived(
    map: "SphericalMap", out: Path, texture: bool, icosphere: int | None, image: int | None
) -> list[Path]:
    """What only a bijective map can give, as far as it is asked for."""
    paths = _write_texture(map, out) if texture else []
    paths += [] if icosphere is None else _write_remesh(map, out, icosphere)
    return paths + ([] if image is None else _write_image(map, out, image))


def _write_texture(map: "SphericalMap", out: Path) -> list[Path]:
    from gensp.export.textured import write_textured
    from gensp.pictures.texture import equirectangular_picture

    picture = equirectangular_picture(1024)
    return write_textured(map, picture, out / f"{map.name}_textured")


def _write_remesh(map: "SphericalMap", out: Path, level: int) -> list[Path]:
    from gensp.geometry.sphere import icosphere
    from gensp.geometry.spherical_map import SphericalMap, save_map

    ball, name = icosphere(level), f"{map.name}_icosphere{level}"
    remesh = map.icosphere_remesh(level)
    save_map(SphericalMap(ball.vertices, remesh.vertices, ball.faces, name), out)
    return [out / f"{name}.npz", out / f"{name}.ply"]


def _write_image(map: "SphericalMap", out: Path, size: int) -> list[Path]:
    from gensp.export.images import write_geometry_image
    from gensp.geometry.octahedral import geometry_image

    positions = geometry_image(map, size)
    return write_geometry_image(positions, out / f"{map.name}_geometry{size}.png")
