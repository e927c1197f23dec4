"""A spherical map of one shape, by any method."""

import pickle
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from gensp.compute import Row
from gensp.data.shapes import ShapeCollection
from gensp.files import save_npz
from gensp.geometry.spherical_map import save_map
from gensp.layout import item_file, item_folder
from gensp.methods import SphericalParameterization
from gensp.methods.hierarchical import compile_loops

MakeMethod = Callable[[], SphericalParameterization]


@dataclass(frozen=True)
class Parameterize:
    """Map one shape and write `maps/<id>.npz`, `maps/<id>.ply` and `predictions/<id>.npz`.

    Attributes
    ----------
    make
        Makes the method; it travels to the workers in its place, and is called once in each.
    """

    collection: ShapeCollection
    make: MakeMethod
    folder: Path

    def __call__(self, id: str) -> Row:
        """Write the shape's files and give its row of diagnostics."""
        mesh = self.collection.mesh(id)
        compiling = compile_loops()
        method = _method(pickle.dumps(self.make))
        began = time.process_time()
        map = method(mesh)
        spent = time.process_time() - began
        if map.arrays:
            save_npz(item_file(self.folder, "predictions", id), **map.arrays)
        save_map(map, item_folder(self.folder, "maps", id))
        timed = {**map.diagnostics, "processor_seconds": spent, "seconds_compile": compiling}
        numbers = {key: _plain(value) for key, value in timed.items()}
        shape = self.collection.shape(id)
        return {"id": id, "split": shape.split, "vertices": len(mesh.vertices), **numbers}


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return round(value, 6) if isinstance(value, float) else value


# Keyed by what the method is made from: every item arrives in a worker as a new task.
@lru_cache(maxsize=1)
def _method(pickled: bytes) -> SphericalParameterization:
    make: MakeMethod = pickle.loads(pickled)
    return make()


def parameterize_task(
    inputs: Mapping[str, Any],
    folder: Path,
    *,
    collection: ShapeCollection,
    method: Callable[..., SphericalParameterization],
) -> Parameterize:
    """The work on one shape, for the items' DataModule.

    Parameters
    ----------
    method
        Makes the method; called with the trained networks' file if the method has any.
    """
    trained = inputs.get("finetune")
    make = method if trained is None else partial(method, trained.folder / "model.pt")
    return Parameterize(collection, make, Path(folder))


def parameterize_items(
    inputs: Mapping[str, Any], folder: Path, *, collection: ShapeCollection
) -> list[str]:
    """All usable shapes, those that no stage was trained on included."""
    return collection.ids()
