"""Tasks and collections whose items fail or kill their process, shared by tests of workers."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gensp.compute import Row
from gensp.data.shapes import ShapeCollection
from gensp.errors import BadMesh, OutputError
from gensp.geometry.mesh import Mesh


@dataclass(frozen=True)
class Trying:
    """Kills a process at some items, as the system does for want of memory; fails at others.

    Attributes
    ----------
    once, always
        Items that kill the first time, or every time.
    whom
        The process that dies: the item's own, or its parent (the task of an array).
    """

    folder: Path
    once: tuple[str, ...] = ()
    always: tuple[str, ...] = ()
    whom: Callable[[], int] = os.getpid

    def __call__(self, item: str) -> Row:
        if item == "bad":
            raise BadMesh(f"{item}: found holes")
        if item == "full":
            raise OutputError(f"{item}: cannot be written")
        mark = self.folder / f"{item.replace('/', '-')}.died"
        if item in self.always or (item in self.once and not mark.exists()):
            mark.touch()
            os.kill(self.whom(), signal.SIGKILL)
            os.kill(os.getpid(), signal.SIGKILL)  # as SLURM ends all processes of a task
        return {"id": item, "process": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


class Deadly(ShapeCollection):
    """Two of its meshes kill whoever reads them, or raise an error of the program."""

    def mesh(self, id: str) -> Mesh:
        """The mesh, unless it is one of these."""
        if id == "deadly":
            os.kill(os.getpid(), signal.SIGKILL)
        if id == "raising":
            raise IndexError("index 7 is out of bounds")
        return super().mesh(id)
