"""Stage III-a, paired: the root registered to every input, from where the tree leads (ours)."""

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gensp.compute import Row
from gensp.errors import RegistrationFailed
from gensp.files import load_npz, save_npz
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration import register
from gensp.layout import item_file
from gensp.tasks.correspond import judged
from gensp.tasks.pairing import RegisterPair

STARTS = "starts.npz"


@dataclass(frozen=True)
class Settle:
    """Register the root's mesh to one input and write `images/<id>.npz`.

    A chain of registrations adds up what each of them slides. It ends near enough for one
    registration from the root itself, which begins less stiff than those of pairs: stiffer, it
    would undo what the chain knows (measured, docs/findings.md).
    """

    task: RegisterPair
    folder: Path

    @classmethod
    def prepared(
        cls, task: RegisterPair, folder: Path, root: Mesh, starts: Mapping[str, np.ndarray]
    ) -> "Settle":
        """Keep the root and the starts of all inputs where the workers find them.

        What was settled from other starts is removed first.
        """
        arrays = {
            "ids": np.array(list(starts)),
            "starts": np.stack(list(starts.values())),
            "vertices": root.vertices,
            "faces": root.faces,
            "schedule": np.array(task.softened.schedule),
        }
        path = folder / STARTS
        known = load_npz(path) if path.is_file() else {}
        same = known.keys() == arrays.keys() and all(
            np.array_equal(known[name], value) for name, value in arrays.items()
        )
        if folder.is_dir() and not same:
            shutil.rmtree(folder)
        save_npz(path, **arrays)
        return cls(task, folder)

    @cached_property
    def _stored(self) -> dict[str, np.ndarray]:
        return load_npz(self.folder / STARTS)

    def __call__(self, id: str) -> Row:
        """Register, and keep the result if it meets the bounds of the tree's edges."""
        began = time.perf_counter()
        stored = self._stored
        start = stored["starts"][stored["ids"].tolist().index(id)]
        root = Mesh(stored["vertices"], stored["faces"], "root")
        row: Row = {"id": id, "kept": False}
        vertices = start
        try:
            found = register(
                root, [self.task.shape(id).mesh], settings=self.task.softened, start=start
            )
        except RegistrationFailed as error:
            row["complaints"] = str(error)
        else:
            row |= judged(found, self.task.acceptance) | {"strain": found.strain}
            vertices = found.vertices if row["kept"] else start
        save_npz(self._path(id), vertices=vertices)
        return row | {"seconds": round(time.perf_counter() - began, 3)}

    def image(self, id: str) -> Float[np.ndarray, "n 3"]:
        """The root's vertices on an input."""
        vertices: np.ndarray = load_npz(self._path(id))["vertices"]
        return vertices

    def _path(self, id: str) -> Path:
        return item_file(self.folder, "images", id)
