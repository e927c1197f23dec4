"""Morph one shape into another through the learnt latent space (paper, shape morphing).

    python examples/morph_two_shapes.py runs/quickstart/full/finetune/model.pt A.ply B.ply

Every frame is g(z, ·) on the same icosphere, so all frames correspond vertex by vertex.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from gensp import GenSP, Mesh, load_mesh, save_mesh
from gensp.errors import GenSPError
from gensp.geometry.mesh import normalize, require_genus_zero
from gensp.methods.fitting import NoFit
from gensp.methods.refinement import NoRefinement
from gensp.pictures.montage import save_png
from gensp.pictures.render import look
from gensp.pictures.sheets import morph_tiles, strips


def read(path: Path) -> Mesh:
    """A mesh that the model can encode: closed, genus 0, area 4π."""
    mesh = load_mesh(path)
    require_genus_zero(mesh)
    return normalize(mesh)


def morph(model: GenSP, first: Mesh, second: Mesh, frames: int) -> list[Mesh]:
    """Surfaces on the straight line between the two codes."""
    start, end = model.encode(first), model.encode(second)
    times = np.linspace(0, 1, frames, dtype=start.dtype)
    return [model.generate((1 - t) * start + t * end) for t in times]


def main() -> None:
    """Encode, interpolate, write the frames, draw them."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("model", type=Path, help="model.pt of stage=finetune")
    arguments.add_argument("meshes", type=Path, nargs=2, help="two closed genus-0 meshes")
    arguments.add_argument("--frames", type=int, default=7)
    arguments.add_argument("--level", type=int, default=5, help="of the icosphere")
    arguments.add_argument("--out", type=Path, default=Path("outputs"), help="folder")
    chosen = arguments.parse_args()

    model = GenSP.load(chosen.model, fit=NoFit(), refine=NoRefinement(), level=chosen.level)
    first, second = (read(path) for path in chosen.meshes)
    meshes = morph(model, first, second, chosen.frames)

    name = f"{first.name}-{second.name}"
    for k, mesh in enumerate(meshes):
        save_mesh(mesh, chosen.out / name / f"{k:02d}.ply")
    tiles = morph_tiles(meshes, second.name, look(up="y"), 360)
    picture = save_png(
        strips([tiles], name, "straight line between codes"), chosen.out / f"{name}.png"
    )
    print(f"{len(meshes)} meshes in {chosen.out / name}, {picture}")


if __name__ == "__main__":
    try:
        main()
    except GenSPError as error:
        sys.exit(str(error))
