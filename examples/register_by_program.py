"""The rotation between two maps by Register, the program of Baden, Crane & Kazhdan, beside ours.

    python examples/register_by_program.py A.ply B.ply --program FOLDER/Register

A.ply and B.ply are maps as `gensp parameterize` or stage `parameterize` write them: they have the
vertex properties x, y, z, px, py, pz that the program reads. It writes the mesh of A with its
sphere positions turned to those of B; the rotation is the one that does so.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from gensp import load_mesh
from gensp.geometry.alignment import best_rotation
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.sphere_files import read_sphere_positions


def by_program(program: str, a: Path, b: Path) -> np.ndarray:
    """Rotation (3, 3) from the sphere of `a` to that of `b` by the program."""
    count = len(load_mesh(a).vertices)
    with tempfile.TemporaryDirectory() as folder:
        turned = Path(folder) / "turned.ply"
        subprocess.run([program, "--in", str(a), str(b), "--out", str(turned)], check=True)
        return best_rotation(read_sphere_positions(a, count), read_sphere_positions(turned, count))


def by_us(a: Path, b: Path) -> np.ndarray:
    """The same by this package."""
    signals = []
    for path in (a, b):
        mesh = load_mesh(path)
        sphere = read_sphere_positions(path, len(mesh.vertices))
        signals.append(density_signal(sphere, mesh.faces, mesh.face_areas))
    return register_rotation(*signals, candidates=1)[0].rotation


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("a", type=Path)
    parser.add_argument("b", type=Path)
    parser.add_argument("--program", default="Register", help="the executable")
    chosen = parser.parse_args()
    theirs = by_program(chosen.program, chosen.a, chosen.b)
    ours = by_us(chosen.a, chosen.b)
    apart = np.degrees(np.arccos(np.clip((np.trace(theirs @ ours.T) - 1) / 2, -1, 1)))
    print(f"theirs\n{theirs.round(6)}\nours\n{ours.round(6)}\napart by {apart:.3f} degrees")
