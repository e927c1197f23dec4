"""Stage III-a, paired: the root registered to every input, from where the tree leads (ours)."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gensp.compute import Row
from gensp.files import load_npz, save_npz
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration import RegistrationSettings, register
from gensp.tasks.pairing import RegisterPair

STARTS = "starts.npz"
STIFFEST = 30.0


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
        """Keep the root and the starts of all inputs where the workers find them."""
        positions = np.stack(list(starts.values()))
        save_npz(
            folder / STARTS,
            ids=np.array(list(starts)),
            starts=positions,
            vertices=root.vertices,
            faces=root.faces,
        )
        return cls(task, folder)

    @cached_property
    def _stored(self) -> dict[str, np.ndarray]:
        return load_npz(self.folder / STARTS)

    @property
    def _settings(self) -> RegistrationSettings:
        whole = self.task.settings
        soft = tuple(step for step in whole.schedule if step[0] <= STIFFEST)
        return replace(whole, schedule=soft)

    def __call__(self, id: str) -> Row:
        """Register, and keep the result if it meets the bounds of the tree's edges."""
        began = time.perf_counter()
        stored = self._stored
        start = stored["starts"][stored["ids"].tolist().index(id)]
        root = Mesh(stored["vertices"], stored["faces"], "root")
        found = register(
            root, [self.task.shape(id).mesh], settings=self.task.settings, start=start
        )
        complaint = self.task.acceptance.complaint(found)
        kept = complaint == ""
        save_npz(self._path(id), vertices=found.vertices if kept else start)
        return {
            "id": id,
            "kept": kept,
            "strain": found.strain,
            "residual": found.residual,
            "coverage": found.coverage,
            "fold_rate": found.fold_rate,
            "complaints": complaint,
            "seconds": round(time.perf_counter() - began, 3),
        }

    def image(self, id: str) -> Float[np.ndarray, "n 3"]:
        """The root's vertices on an input."""
        vertices: np.ndarray = load_npz(self._path(id))["vertices"]
        return vertices

    def _path(self, id: str) -> Path:
        return self.folder / "images" / f"{id}.npz"
