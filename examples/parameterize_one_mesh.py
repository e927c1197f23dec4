"""Map one closed genus-0 mesh to the sphere, and draw it.

    python examples/parameterize_one_mesh.py data/heads/meshes/id014_neutral.ply
    python examples/parameterize_one_mesh.py MESH --model runs/quickstart/full/finetune/model.pt

Without a model the map is that of conformalised mean curvature flow, which learns nothing.
"""

import argparse
import sys
from pathlib import Path

from gensp import CMCF, GenSP, SphericalMap, load_mesh, save_map
from gensp.errors import GenSPError
from gensp.geometry.mesh import require_genus_zero
from gensp.methods import SphericalParameterization
from gensp.methods.fitting import NoFit, RegisterFit
from gensp.methods.refinement import NewtonRefinement
from gensp.pictures.montage import save_png
from gensp.pictures.render import look
from gensp.pictures.sheets import draw_map, map_strip, textured_sphere


def method_of(model: Path | None, register: bool) -> SphericalParameterization:
    """The learnt method if there is a model, else the flow; both refined without folds."""
    if model is None:
        return CMCF(refine=NewtonRefinement(pull=0.0))
    fit = RegisterFit() if register else NoFit()
    return GenSP.load(model, fit=fit, refine=NewtonRefinement(pull=30.0))


def report(map: SphericalMap) -> str:
    """The figures of the paper's table for one map."""
    distortion = map.distortion()
    return (
        f"{map.name}: mean σ {distortion.mean:.3f}, max σ {distortion.max:.2f}, "
        f"mean σ^con {distortion.conformal_mean:.3f}, {int(map.bad_faces().sum())} bad faces"
    )


def main() -> None:
    """Read, map, write, draw."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("mesh", type=Path, help="ply, obj, off or stl")
    arguments.add_argument("--model", type=Path, help="model.pt of stage=finetune")
    arguments.add_argument("--register", action="store_true", help="fit=register")
    arguments.add_argument("--out", type=Path, default=Path("outputs"), help="folder")
    chosen = arguments.parse_args()

    mesh = load_mesh(chosen.mesh)
    require_genus_zero(mesh)
    map = method_of(chosen.model, chosen.register)(mesh)
    save_map(map, chosen.out)  # NAME.npz and NAME.ply, positions on the sphere included

    view, size = look(up="y"), 480
    strip = map_strip(draw_map(map, view, size), textured_sphere(view, size), map.name, " ")
    picture = save_png(strip, chosen.out / f"{map.name}.png")
    print(report(map))
    print(f"{chosen.out / map.name}.npz, .ply and {picture}")


if __name__ == "__main__":
    try:
        main()
    except GenSPError as error:
        sys.exit(str(error))
