"""Lists of which model is in which split, as ShapeNet and KeypointNet publish them."""

from collections.abc import Iterator
from pathlib import Path

from gensp.data.folder import SPLITS
from gensp.errors import MissingData
from gensp.files import read_rows


def read_splits(path: Path) -> dict[str, str]:
    """<synset id>_<model id> → split, from all.csv or from a folder of train, val, test.txt.

    Raises
    ------
    MissingData
        It is neither of them, or tells two splits of one model.
    """
    listed = _in_folder(path) if path.is_dir() else _in_table(path)
    splits: dict[str, str] = {}
    for id, split in listed:
        if splits.setdefault(id, split) != split:
            raise MissingData(
                f"{path}: {id} is in {splits[id]} and in {split}; one split for every model of a "
                "synset is required; correct the list"
            )
    return splits


def _in_folder(path: Path) -> Iterator[tuple[str, str]]:
    for split in SPLITS:
        file = path / f"{split}.txt"
        lines = file.read_text(encoding="utf-8").split() if file.is_file() else []
        for line in lines:
            if "-" not in line:
                raise MissingData(
                    f"{file}: has the line '{line}'; <synset id>-<model id> is required; mend it"
                )
            yield line.replace("-", "_", 1), split


def _in_table(path: Path) -> Iterator[tuple[str, str]]:
    rows = _rows(path)
    if not rows or not {"synsetId", "modelId", "split"} <= rows[0].keys():
        raise MissingData(
            f"{path}: is no split list; the columns synsetId, modelId and split are required, or "
            "a folder with train.txt, val.txt and test.txt; correct shapes.split_file"
        )
    for row in rows:
        if row["split"] not in SPLITS:
            raise MissingData(
                f"{path}: has the split '{row['split']}'; one of {', '.join(SPLITS)} is "
                "required; correct the column"
            )
        yield f"{row['synsetId']}_{row['modelId']}", row["split"]


def _rows(path: Path) -> list[dict[str, str]]:
    return read_rows(path) if path.is_file() else []
