"""A statistical shape model of a finished run: mean and principal modes on one triangulation.

    python examples/shape_model.py runs/quickstart/full+register/parameterize/maps --out outputs

Every map carries one icosphere to its shape, so vertex i is the same point on all of them. The
shapes are brought to one size, place and orientation (generalised Procrustes analysis), then their
deviations from the mean are split into principal components.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gensp import Mesh, load_map, save_mesh
from gensp.errors import GenSPError
from gensp.files import atomic_path
from gensp.geometry.mesh import normalize
from gensp.geometry.sphere import icosphere
from gensp.pictures.montage import Tile, save_png
from gensp.pictures.render import Scene, look
from gensp.pictures.sheets import strips

ROUNDS = 5  # of alignment to the mean: the last moves 40 animals by 3e-6 at most
SIZE = 260  # pixels of a drawing
STEPS = np.linspace(-2, 2, 5)  # standard deviations at which a mode is drawn


def aligned(shapes: np.ndarray) -> np.ndarray:
    """Centred shapes (k, n, 3) turned so that each is nearest to their mean."""
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    for _ in range(ROUNDS):
        mean = shapes.mean(axis=0)
        shapes = np.stack([Rotation.align_vectors(mean, x)[0].apply(x) for x in shapes])
    return shapes


def principal_modes(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (n, 3), orthonormal modes (k, n, 3), largest first, and standard deviations (k,)."""
    mean = shapes.mean(axis=0)
    away = (shapes - mean).reshape(len(shapes), -1)
    _, sizes, modes = np.linalg.svd(away, full_matrices=False)
    return mean, modes.reshape(-1, *mean.shape), sizes / np.sqrt(max(len(shapes) - 1, 1))


def remeshes(folder: Path, level: int) -> list[Mesh]:
    """All shapes of a run on one icosphere, at area 4π."""
    paths = sorted(folder.rglob("*.npz"))
    return [normalize(load_map(path).icosphere_remesh(level)) for path in paths]


def save_model(path: Path, names: Sequence[str], **arrays: np.ndarray) -> None:
    """One npz, whole or not at all."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, names=np.array(names), **arrays)


def mode_tiles(frames: Sequence[Mesh], label: str, level: int, up: str) -> list[Tile]:
    """One mode, at one scale, in the texture of the sphere."""
    points = icosphere(level).vertices
    view = look(up).fitted(*(mesh.vertices for mesh in frames))
    images = [Scene(mesh, view, SIZE).textured(points) for mesh in frames]
    return [
        Tile(image, f"{step:+g}" if step else "mean", label)
        for image, step in zip(images, STEPS, strict=True)
    ]


def main() -> None:
    """Read maps, align, analyse, write the model, its meshes and a picture."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("maps", type=Path, help="folder maps/ of stage=parameterize")
    arguments.add_argument("--level", type=int, default=5, help="of the icosphere")
    arguments.add_argument("--modes", type=int, default=3, help="drawn and written as meshes")
    arguments.add_argument("--up", default="y", help="axis that points up in the picture")
    arguments.add_argument("--out", type=Path, default=Path("outputs"), help="folder")
    chosen = arguments.parse_args()

    found = remeshes(chosen.maps, chosen.level)
    if len(found) < 2:
        arguments.error(f"{chosen.maps}: has {len(found)} maps; two or more are required")
    faces, names = found[0].faces, [mesh.name for mesh in found]
    mean, modes, deviations = principal_modes(aligned(np.stack([m.vertices for m in found])))
    model = {"mean": mean, "modes": modes, "deviations": deviations, "faces": faces}
    save_model(chosen.out / "shape_model.npz", names, **model)
    save_mesh(Mesh(mean, faces, "mean"), chosen.out / "mean.ply")

    shares = deviations**2 / np.sum(deviations**2)
    rows = []
    for k in range(min(chosen.modes, len(found) - 1)):
        frames = [Mesh(mean + s * deviations[k] * modes[k], faces) for s in STEPS]
        save_mesh(frames[0], chosen.out / f"mode{k + 1}_minus.ply")
        save_mesh(frames[-1], chosen.out / f"mode{k + 1}_plus.ply")
        rows.append(mode_tiles(frames, f"mode {k + 1}: {shares[k]:.0%}", chosen.level, chosen.up))
    picture = strips(rows, f"{len(found)} shapes", "principal modes, in standard deviations")
    path = save_png(picture, chosen.out / "shape_model.png")
    print(f"{len(found)} shapes; variance of the first modes: {shares[:5].round(3)}; {path}")


if __name__ == "__main__":
    try:
        main()
    except GenSPError as error:
        sys.exit(str(error))
