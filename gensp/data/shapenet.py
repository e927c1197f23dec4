"""ShapeNetCore.v2 as a raw collection, with the keypoints of KeypointNet.

Sources of the layouts: Chang et al., ShapeNet: An Information-Rich 3D Model Repository, 2015;
You et al., KeypointNet, 2020.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gensp.data.folder import SPLITS, held_out
from gensp.data.ground_truth import GroundTruth
from gensp.data.keypoints import Record, read_annotations
from gensp.data.raw import require_preparing
from gensp.errors import DamagedFile, MissingData, Unsupported
from gensp.files import content_hash, read_json, read_rows
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
        ShapeNet's all.csv (modelId, split), or KeypointNet's folder splits/; models that it does
        not name are not used. Without it a share `test_fraction` of the usable shapes is held
        out, drawn by `split_seed`.

    Raises
    ------
    MissingData
        The tree, a synset, the annotations or the split file are missing.
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
        if annotated and keypoints is None:
            raise Unsupported(
                "shapes.annotated=true: no annotations were given; KeypointNet's folder is "
                "required; add shapes.keypoints=FOLDER"
            )
        self._categories = self._named(synsets)
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
        return content_hash(found, self._listed, self.test_fraction, self.split_seed)

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
        """Splits of the usable models, from the file or drawn among them."""
        if self._listed is not None:
            return {id: self._listed[id.split("_", 1)[1]] for id in ids}
        test = held_out(len(ids), self.test_fraction, self.split_seed) if ids else set()
        return {id: "test" if place in test else "train" for place, id in enumerate(ids)}

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
            if path.is_dir() and (self._listed is None or path.name in self._listed)
        ]
        found = [id for id in found if not annotated or id in self._records]
        if not found:
            raise MissingData(
                f"{self.root}: has no model left to use; models in shapes.synsets, in "
                "shapes.split_file and, with shapes.annotated, in the annotations are required; "
                "widen one of them"
            )
        if limit is None or limit >= len(found):
            return found
        drawn = np.random.default_rng(self.split_seed).permutation(len(found))[:limit]
        return [found[place] for place in np.sort(drawn)]

    @property
    def _records(self) -> dict[str, Record]:
        return {} if self.keypoints is None else read_annotations(self.keypoints)


def read_splits(path: Path) -> dict[str, str]:
    """Model id → split, from ShapeNet's all.csv or KeypointNet's folder of train, val, test.txt.

    Raises
    ------
    MissingData
        It is neither of them.
    """
    if path.is_dir():
        lists = {split: path / f"{split}.txt" for split in SPLITS}
        return {
            line.strip().split("-", 1)[-1]: split
            for split, file in lists.items()
            if file.is_file()
            for line in file.read_text(encoding="utf-8").splitlines()
            if line.strip()
        }
    rows = _rows(path)
    if not rows or not {"modelId", "split"} <= rows[0].keys():
        raise MissingData(
            f"{path}: is no split list; the columns modelId and split are required, or a folder "
            "with train.txt, val.txt and test.txt; correct shapes.split_file"
        )
    wrong = {row["split"] for row in rows} - set(SPLITS)
    if wrong:
        raise MissingData(
            f"{path}: has the split '{min(map(str, wrong))}'; one of {', '.join(SPLITS)} is "
            "required; correct the column"
        )
    return {row["modelId"]: row["split"] for row in rows}


def _rows(path: Path) -> list[dict[str, str]]:
    return read_rows(path) if path.is_file() else []


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
