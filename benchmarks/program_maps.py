"""Maps of a program of other authors, and of ours, under the energies of both.

    OMP_NUM_THREADS=1 python benchmarks/program_maps.py MESH … --programs FOLDER --tool SphereParam

Rows of every mesh: the program's map by `method=external`; those of our methods; and what the
last Newton iteration of `dirichlet` makes of the program's. Columns: the L² stretch ½ Σ A ‖J⁻¹‖²
and its inverse term 10⁻⁴ Σ A (σ₁⁶ + σ₂⁶) of `stretch`; the last energy of `dirichlet`; four
distortions.
"""

import argparse
import sys
from pathlib import Path

import hydra

from gensp.geometry.distortion import singular_values
from gensp.geometry.mesh import Mesh, load_mesh, normalize
from gensp.geometry.spherical_energy import SphericalEnergy, triangle_weights
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods import SphericalParameterization
from gensp.methods.hierarchical import NewtonPolish, dirichlet
from gensp.methods.outcome import certified
from gensp.methods.table import per_shape

HEAD = (
    "| mesh | map | stretch | inverse | last energy of dirichlet | mean σ | max σ | mean σ^con "
    "| max σ^con |\n|---|---|--:|--:|--:|--:|--:|--:|--:|\n"
)
LAST = dirichlet().fine


def program_of(tool: str, programs: Path) -> SphericalParameterization:
    """`method=external` as its configuration has it."""
    words = ["method=external", f"method.tool={tool}", f"method.programs={programs}"]
    with hydra.initialize_config_module("conf", version_base="1.3"):
        method = hydra.compose("config", words).method.object
    made: SphericalParameterization = hydra.utils.instantiate(method)()
    return made


def line(label: str, map: SphericalMap, mesh: Mesh) -> str:
    """A row of the table; `mesh` is at area 4π."""
    areas = mesh.face_areas
    values = singular_values(mesh.vertices, map.sphere, mesh.faces)
    stretch = areas @ (0.5 * (values**-2.0).sum(axis=1))
    inverse = areas @ (1e-4 * (values**6).sum(axis=1))
    assert isinstance(LAST, NewtonPolish)
    weights = triangle_weights(mesh, LAST.floor)
    last = SphericalEnergy(mesh, weights, LAST.energy).energy(map.sphere)
    found = map.distortion()
    figures = (found.mean, found.max, found.conformal_mean, found.conformal_max)
    cells = [f"{value:.4g}" for value in (stretch, inverse, last, *figures)]
    return f"| {mesh.name} | {label} | {' | '.join(cells)} |\n"


def lines(
    path: Path, tool: str, program: SphericalParameterization, methods: list[str]
) -> list[str]:
    """All rows of a mesh."""
    mesh = load_mesh(path)
    shape = normalize(mesh)
    theirs = program(mesh)
    rows = [line(tool, theirs, shape)]
    rows += [line(f"`{name}`", per_shape(name)(mesh), shape) for name in methods]
    assert LAST is not None
    refined = certified(mesh, LAST(shape, theirs.sphere).sphere, {})
    return [*rows, line(f"{tool}, then Newton", refined, shape)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path, nargs="+", metavar="MESH")
    parser.add_argument("--programs", type=Path, required=True, help="folder of executables")
    parser.add_argument("--tool", default="SphereParam", help="of conf/method/external.yaml")
    parser.add_argument("--methods", nargs="+", default=["stretch", "dirichlet"])
    given = parser.parse_args()
    program = program_of(given.tool, given.programs)
    sys.stdout.write(HEAD)
    for path in given.meshes:
        sys.stdout.writelines(lines(path, given.tool, program, given.methods))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
