"""The refinement of one head on one core, from the end of its mean curvature flow.

python benchmarks/newton.py
"""

import time
from pathlib import Path

from gensp.geometry.mesh import Mesh, load_mesh, normalize
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.cmcf import CMCF
from gensp.methods.refinement import NewtonRefinement, NoRefinement

MESHES = Path(__file__).parents[1] / "data" / "heads" / "meshes"
FINE_LEVEL = 6


def head() -> Mesh:
    """The head of the embedded collection that comes nearest to 5,000 vertices."""
    meshes = [load_mesh(path) for path in sorted(MESHES.glob("*.ply"))]
    return normalize(min(meshes, key=lambda mesh: abs(len(mesh.vertices) - 5000)))


def refined(mesh: Mesh) -> tuple[float, SphericalMap]:
    """Processor seconds of untangling and Newton, and the map."""
    flowed = CMCF(NoRefinement())(mesh)
    start = time.process_time()
    map = NewtonRefinement()(mesh, flowed.sphere)
    return time.process_time() - start, map


def rows(mesh: Mesh, map: SphericalMap, seconds: float, required: str) -> list[tuple[object, ...]]:
    """Time and quality of one refined map."""
    name, distortion = f"refinement, {len(mesh.vertices):,} vertices", map.distortion()
    steps = map.diagnostics["iterations"]
    return [
        (f"{name}, {steps} Newton steps", seconds, "s", required),
        (f"{name}, bad faces", float(map.bad_faces().sum()), "", "0"),
        (f"{name}, mean σ", distortion.mean, "", ""),
        (f"{name}, max σ", distortion.max, "", ""),
    ]


def measure() -> list[dict[str, object]]:
    """A head as it is, and its surface resampled at the vertices of an icosphere."""
    coarse = head()
    seconds, map = refined(coarse)
    found = rows(coarse, map, seconds, "≤ 3")
    fine = normalize(map.icosphere_remesh(FINE_LEVEL))
    seconds, map = refined(fine)
    found += rows(fine, map, seconds, "≤ 40")
    keys = ("name", "figure", "unit", "required")
    return [dict(zip(keys, row, strict=True)) for row in found]


if __name__ == "__main__":
    for line in measure():
        print("{name:60s} {figure:8.3g} {unit:2s} {required}".format(**line))  # noqa: T201
