"""ShapeNetCore.v2 as a raw collection, with the keypoints of KeypointNet.

Sources of the layouts: Chang et al., ShapeNet: An Information-Rich 3D Model Repository, 2015;
You et al., KeypointNet, 2020.
"""

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gensp.data.folder import held_out
from gensp.data.ground_truth import GroundTruth
from gensp.data.keypoints import Record, read_annotations
from gensp.data.raw import require_preparing
from gensp.data.split_lists import read_splits
from gensp.errors import DamagedFile, MissingData, Unsupported
from gensp.files import content_hash, read_json
from gensp.geometry.mesh import Mesh, load_mesh

LICENCE = "ShapeNet terms of use"


class ShapeNet:
    """Models of a ShapeNetCore.v2 tree; a shape's id is <synset id>_<model id>.

    Parameters
    ----------
    root
        The folder that holds taxonomy.json and a folder for every synset.
    synsets
        Ids or names of the synsets; all that are there without it.
    keypoints
        KeypointNet's folder, with annotations/; None for none.
    annotated
        Only models that have keypoints.
    limit
        At most so many models, drawn by `split_seed`; None for all.
    split_file
        ShapeNet's all.csv (synsetId, modelId, split), or KeypointNet's folder splits/; models
        that it does not name are not used. Without it a share `test_fraction` of the usable
        models is held out, drawn by `split_seed`; a model of several synsets is on one side.
    train, test
        So many of the usable shapes of either side, drawn by `split_seed`; with None all. Where
        no file tells the sides, both are drawn, and a model is taken once.

    Raises
    ------
    MissingData
        The tree, a synset, the annotations or the split file are missing; of `splits`: there are
        fewer usable shapes than asked for.
    Unsupported
        A stage other than prepare asks for it, or `annotated` without keypoints.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        name: str = "shapenet",
        synsets: Sequence[str] | None = None,
        keypoints: Path | str | None = None,
        annotated: bool = False,
        limit: int | None = None,
        split_file: Path | str | None = None,
        test_fraction: float = 0.1,
        train: int | None = None,
        test: int | None = None,
        split_seed: int = 0,
        up: str = "y",
        on_bad: str = "error",
        max_faces: int | None = None,
        cache: Path | str | None = None,
    ) -> None:
        require_preparing(name, on_bad, root)
        self.name, self.up, self.root = name, up, Path(root)
        self.keypoints = None if keypoints is None else Path(keypoints)
        self.test_fraction, self.split_seed = test_fraction, split_seed
        self._counts = {"train": train, "test": test}
        if annotated and keypoints is None:
            raise Unsupported(
                "shapes.annotated=true: no annotations were given; KeypointNet's folder is "
                "required; add shapes.keypoints=FOLDER"
            )
        self._categories = self._named(synsets)
        self._tell_left_out()
        self._listed = None if split_file is None else read_splits(Path(split_file))
        self._ids = self._models(annotated, limit)

    def ids(self) -> list[str]:
        """All models, ordered by synset and name."""
        return list(self._ids)

    def mesh(self, id: str) -> Mesh:
        """The model as stored: soups, open shells and inner parts included."""
        return replace(load_mesh(self._path(id)), name=id)

    def digest(self, id: str) -> str:
        """Changes with the model's file or its keypoints."""
        return content_hash(_digest(self._path(id)), self.keypoint_record(id))

    @cached_property
    def fingerprint(self) -> str:
        """Changes with any model in use, its keypoints or the split."""
        found = [(id, self.digest(id)) for id in self._ids]
        cut = {side: count for side, count in self._counts.items() if count is not None}
        return content_hash(
            found, self._listed, self.test_fraction, self.split_seed, *([cut] * bool(cut))
        )

    def unread_keypoints(self) -> dict[str, str]:
        """Models whose annotations cannot be read, and why."""
        return {} if self.keypoints is None else read_annotations(self.keypoints)[1]

    def columns(self, id: str) -> dict[str, str]:
        """Category, source and licence."""
        synset, model = id.split("_", 1)
        source = f"ShapeNetCore.v2 {synset}/{model}"
        return {"category": self._categories[synset], "source": source, "licence": LICENCE}

    def ground_truth(self, id: str) -> GroundTruth | None:
        """ShapeNet has no dense correspondences."""
        return None

    def keypoint_record(self, id: str) -> Record | None:
        """KeypointNet's annotation of the model."""
        return self._records.get(id)

    def __getstate__(self) -> dict[str, Any]:
        # Workers find a model by its id; the lists would travel to them with every item.
        kept = {key: value for key, value in vars(self).items() if key != "fingerprint"}
        return {**kept, "_ids": [], "_listed": None}

    def splits(self, ids: Sequence[str]) -> dict[str, str]:
        """Splits of the usable models, from the file or drawn; without those that are too many."""
        found = self._sides(ids)
        counts = {side: count for side, count in self._counts.items() if count is not None}
        there = {side: [id for id in found if found[id] == side] for side in counts}
        for side, count in counts.items():
            if count > len(there[side]):
                raise MissingData(
                    f"{self.root}: {len(there[side])} usable shapes can be {side} shapes; "
                    f"shapes.{side}={count} are required; ask for fewer, or raise shapes.limit"
                )
        taken = {id for side, count in counts.items() for id in self._drawn(there[side], count)}
        return {id: side for id, side in found.items() if side not in counts or id in taken}

    def _sides(self, ids: Sequence[str]) -> dict[str, str]:
        if self._listed is not None:
            return {id: self._listed[id] for id in ids}
        first: dict[str, str] = {}
        for id in ids:
            first.setdefault(_model(id), id)
        models, (train, test) = list(first), self._counts.values()
        if train is None or test is None:
            places = held_out(len(models), self.test_fraction, self.split_seed) if ids else set()
            out = {models[place] for place in places}
            return {id: "test" if _model(id) in out else "train" for id in ids}
        drawn = [first[model] for model in self._drawn(models, train + test)]
        out = set(self._drawn(drawn, test))
        return {id: "test" if id in out else "train" for id in drawn}

    def _drawn(self, found: Sequence[str], count: int) -> list[str]:
        """So many of them, drawn by the seed, in their order."""
        places = np.random.default_rng(self.split_seed).permutation(len(found))[:count]
        return [found[place] for place in np.sort(places)]

    def _path(self, id: str) -> Path:
        return self.root.joinpath(*id.split("_", 1), "models", "model_normalized.obj")

    def _named(self, synsets: Sequence[str] | None) -> dict[str, str]:
        """Synset id → name of those in use."""
        if not self.root.is_dir():
            raise MissingData(
                f"{self.root}: is not a folder; the tree of ShapeNetCore.v2 is required; set "
                "shapes.root=FOLDER"
            )
        names = _taxonomy(self.root)
        there = sorted(path.name for path in self.root.iterdir() if _is_synset(path))
        known = {**{names.get(id, id): id for id in there}, **{id: id for id in there}}
        unknown = [word for word in synsets or () if str(word) not in known]
        if unknown or not there:
            raise MissingData(
                f"{self.root}: has no synset {unknown[0] if unknown else ''}; folders of eight "
                f"digits are required; there are {', '.join(known) or 'none'}; correct "
                "shapes.synsets"
            )
        chosen = sorted({known[str(word)] for word in synsets}) if synsets else there
        return {id: names.get(id, id) for id in chosen}

    def _models(self, annotated: bool, limit: int | None) -> list[str]:
        found = [
            f"{synset}_{path.name}"
            for synset in self._categories
            for path in sorted((self.root / synset).iterdir())
            if path.is_dir()
        ]
        found = [id for id in found if self._listed is None or id in self._listed]
        found = [id for id in found if not annotated or id in self._records]
        if not found:
            raise MissingData(
                f"{self.root}: has no model left to use; models in shapes.synsets, in "
                "shapes.split_file and, with shapes.annotated, in the annotations are required; "
                "widen one of them"
            )
        if limit is None or limit >= len(found):
            return found
        return self._drawn(found, limit)

    @property
    def _records(self) -> dict[str, Record]:
        return {} if self.keypoints is None else read_annotations(self.keypoints)[0]

    def _tell_left_out(self) -> None:
        """Warn of the models whose annotations cannot be read."""
        faults = self.unread_keypoints()
        if faults:
            listed = "; ".join(f"{id} ({why})" for id, why in faults.items())
            warnings.warn(
                f"{self.keypoints}: {len(faults)} annotations cannot be read and are left out: "
                f"{listed}; mend or remove them",
                stacklevel=3,
            )


def _model(id: str) -> str:
    return id.split("_", 1)[1]


def _taxonomy(root: Path) -> dict[str, str]:
    """Synset id → first of its names, where the tree tells them."""
    path = root / "taxonomy.json"
    if not path.is_file():
        return {}
    try:
        entries: list[dict[str, Any]] = read_json(path)
        return {entry["synsetId"]: entry["name"].split(",")[0] for entry in entries}
    except (DamagedFile, KeyError, TypeError, AttributeError) as error:
        raise MissingData(
            f"{path}: cannot be read ({type(error).__name__}); a list of synsetId and name is "
            "required; restore or remove the file"
        ) from error


def _is_synset(path: Path) -> bool:
    return path.is_dir() and len(path.name) == 8 and path.name.isdigit()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
