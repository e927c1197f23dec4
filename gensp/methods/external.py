"""Programs of other authors behind the protocol of this package's methods."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gensp.errors import ExternalToolFailed, UnreadableMesh
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere_files import read_sphere_positions, write_for_program
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.refinement import NoRefinement

_LONGEST_COMPLAINT = 160


@dataclass(frozen=True)
class Step:
    """One program to run, in a folder of its own beside the files of the steps before it.

    Attributes
    ----------
    command
        The program and its arguments; files are named without a folder. No shell reads them.
    stdout
        File that its standard output goes to.
    """

    command: Sequence[str]
    stdout: str | None = None


@dataclass(frozen=True)
class External:
    """A spherical map by a program that the user has built.

    The mesh is written in the format that the program reads, the steps are run, and the sphere
    positions are read from what they leave. The result is taken as it is; folds are counted.

    Attributes
    ----------
    steps
        What to run, in order.
    mesh, sphere
        Names of the file that is written first and of the one that is read at the end; their
        suffixes choose the formats (`gensp.geometry.sphere_files`).
    programs
        Folder of the executables; without it they are looked up on the search path.
    timeout
        Seconds that all steps may take together.
    """

    steps: Sequence[Step]
    mesh: str
    sphere: str
    programs: Path | str | None = None
    timeout: float = 1800.0
    name: str = "external"

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a mesh; the seconds are those of the steps.

        Raises
        ------
        ExternalToolFailed
            A program is missing, fails, takes too long, or leaves no map of this mesh.
        """
        executables = [self._executable(step.command[0]) for step in self.steps]
        with tempfile.TemporaryDirectory(prefix="gensp-") as folder:
            write_for_program(mesh, Path(folder) / self.mesh)
            began = time.perf_counter()
            for step, executable in zip(self.steps, executables, strict=True):
                left = self.timeout - (time.perf_counter() - began)
                self._run(step, executable, Path(folder), mesh.name, left)
            seconds = time.perf_counter() - began
            positions = self._positions(Path(folder), mesh)
        map = NoRefinement()(mesh, positions)
        return replace(map, diagnostics={**map.diagnostics, "seconds": seconds})

    def _executable(self, program: str) -> str:
        folder = None if self.programs is None else os.fspath(Path(self.programs).absolute())
        found = shutil.which(program, path=folder)
        if found is None:
            where = "on the search path" if folder is None else f"in {folder}"
            raise ExternalToolFailed(
                f"{program}: not found {where}; an executable of this name is required; build "
                "it from its authors' sources and name its folder with method.programs=FOLDER"
            )
        return os.path.abspath(found)

    def _run(self, step: Step, executable: str, folder: Path, shape: str, left: float) -> None:
        program = step.command[0]
        target = folder / (step.stdout or "stdout.txt")
        try:
            with open(target, "wb") as output, open(folder / "stderr.txt", "wb") as errors:
                done = subprocess.run(
                    [executable, *step.command[1:]],
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=errors,
                    timeout=max(left, 0.0),
                    check=False,
                )
        except subprocess.TimeoutExpired as error:
            raise ExternalToolFailed(
                f"{shape}: {program} was ended after {self.timeout:g} seconds; simplify the shape "
                "or set a larger method.timeout"
            ) from error
        except OSError as error:
            raise ExternalToolFailed(
                f"{shape}: {executable} cannot be run ({error.strerror}); a program for this "
                "machine is required; build it again"
            ) from error
        if done.returncode != 0:
            complaint = _last_line(folder / "stderr.txt") or _last_line(folder / "stdout.txt")
            raise ExternalToolFailed(
                f"{shape}: {program} ended with exit code {done.returncode} "
                f"({complaint or 'it said nothing'}); a shape that it can map is required; see "
                "its documentation, or use another method"
            )

    def _positions(self, folder: Path, mesh: Mesh) -> Float[np.ndarray, "n 3"]:
        try:
            return read_sphere_positions(folder / self.sphere, len(mesh.vertices))
        except UnreadableMesh as error:
            program = self.steps[-1].command[0]
            raise ExternalToolFailed(
                f"{mesh.name}: {program} left no spherical map: {error}; see the steps of "
                "conf/method/external.yaml"
            ) from error


def _last_line(path: Path) -> str:
    """The last words of a program, for a message of one line."""
    if not path.is_file():
        return ""
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    spoken = [line.strip() for line in lines if line.strip()]
    return spoken[-1][:_LONGEST_COMPLAINT] if spoken else ""
