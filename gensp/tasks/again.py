"""A further round of Stage III-a: what all images share, registered to every input (ours)."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float

from gensp.compute import Row, run_items, stored_rows
from gensp.errors import RegistrationFailed
from gensp.files import load_npz, save_npz
from gensp.geometry.common_source import low_rank, placed
from gensp.geometry.correspondence import Correspondence
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration import register
from gensp.geometry.sphere import icosphere_of
from gensp.layout import item_file
from gensp.sharing import Workers
from gensp.tasks.correspond import RegisterEdge, judged

SOURCES = "sources.npz"


@dataclass(frozen=True)
class Rounds:
    """How the carried images are made to agree.

    Attributes
    ----------
    count
        Rounds after the icosphere has been carried outward; none is the paper.
    rank
        The source of a shape is its image reduced to the mean of all and so many modes. Few modes
        take away what single chains of registrations added; shapes in different poses need more
        modes than there is bias to lose.
    workers
        Processes that share the shapes.
    """

    count: int = 0
    rank: int = 0
    workers: Workers = field(default_factory=Workers)

    def __call__(
        self, task: RegisterEdge, folder: Path, carried: Mapping[str, Correspondence]
    ) -> tuple[dict[str, Correspondence], list[Row]]:
        """The images after all rounds, and a row for every shape and round."""
        images, rows = dict(carried), []
        for number in range(1, self.count + 1):
            again = RegisterAgain.prepared(
                task, folder / "rounds" / str(number), images, self.rank
            )
            # Everything is registered before anything is read: the order plays no part.
            for _ in run_items(again, list(images), again.folder, self.workers):
                pass
            done = stored_rows(again.folder)
            images |= {
                str(row["id"]): again.result(str(row["id"])) for row in done if row.get("kept")
            }
            rows += [{"round": number, **row} for row in done]
        return images, rows


@dataclass(frozen=True)
class RegisterAgain:
    """Register the common source to one input and write `rounds/<k>/images/<id>.npz`."""

    task: RegisterEdge
    folder: Path

    @classmethod
    def prepared(
        cls, task: RegisterEdge, folder: Path, images: Mapping[str, Correspondence], rank: int
    ) -> Self:
        """Keep the sources of all shapes where the workers find them."""
        points = np.stack([image.points for image in images.values()])
        sources = low_rank(points, np.stack([image.valid for image in images.values()]), rank)
        save_npz(folder / SOURCES, ids=np.array(list(images)), points=sources)
        return cls(task, folder)

    @cached_property
    def _sources(self) -> dict[str, Float[np.ndarray, "n 3"]]:
        stored = load_npz(self.folder / SOURCES)
        return dict(zip((str(id) for id in stored["ids"]), stored["points"], strict=True))

    def __call__(self, id: str) -> Row:
        """Register, and keep the result if it meets the bounds of the tree's edges."""
        start = time.perf_counter()
        points = self._sources[id]
        source, mesh = Mesh(points, icosphere_of(len(points)).faces, id), self.task.mesh(id)
        row: Row = {"id": id, "kept": False}
        try:
            found = register(source, [mesh], settings=self.task.ladder[0])
        except RegistrationFailed as error:
            row["complaints"] = str(error)
        else:
            row |= judged(found, self.task.acceptance)
            save_npz(self._path(id), registered=found.vertices)
        return row | {"seconds": round(time.perf_counter() - start, 3)}

    def result(self, id: str) -> Correspondence:
        """The icosphere's vertices on a shape, as this round registered them."""
        registered = load_npz(self._path(id))["registered"]
        return placed(registered, icosphere_of(len(registered)).faces, self.task.mesh(id))

    def _path(self, id: str) -> Path:
        return item_file(self.folder, "images", id)
