"""Evaluation: distortion, consistency and coverage of the maps, the table and the pictures."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from gensp.comparison import baselines
from gensp.compute import Row, stored_rows
from gensp.data.shapes import ShapeCollection
from gensp.files import read_json, read_rows, write_json, write_text
from gensp.models import Atlas, load_model
from gensp.models.network import Network
from gensp.pictures import PictureOptions, draw_all
from gensp.pictures.material import Generated, evenly
from gensp.pictures.sheets import Way, unmoved
from gensp.runs import SETTINGS, Run
from gensp.stages.base import ItemStage, write_table
from gensp.stages.morphs import LatentTree, straight
from gensp.stages.summary import Record, summarize, without_nan
from gensp.tables import summary_csv, summary_markdown
from gensp.tasks.evaluate import mapped_ids, pairs_path, prediction

FOLDER = "folder"  # what shapes=folder calls any folder
TRAINED = ("implicit", "correspond", "initialize", "finetune")
_BASELINES = 2  # beside this variant in a picture
_HEADLINES = ("error", "sigma_mean")


class EvaluateStage(ItemStage):
    """Passes over the maps; its ending makes the table, the pictures and the page.

    Writes shapes.csv, pairs.csv, summary.json, summary.md, summary.csv, pictures/ and report.html.

    Parameters
    ----------
    runs
        Folders of the stages that were run, `parameterize` among them.
    names
        experiment, variant and method, for the titles.
    neighbours
        Nearest neighbours by Hausdorff distance over which c is averaged (paper: 6).
    pictures
        How much is drawn; none leaves the pictures and the page out.
    """

    def __init__(
        self,
        *,
        collection: ShapeCollection,
        runs: Mapping[str, Path],
        names: Mapping[str, str],
        neighbours: int = 6,
        pictures: PictureOptions | None = None,
        max_failures: int = 0,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(table="shapes", max_failures=max_failures, folder=folder)
        self.collection, self.runs = collection, dict(runs)
        self.names = {**names, "collection": _called(collection, names)}
        self.neighbours = neighbours
        self.pictures = pictures

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **numbers: Any) -> Self:
        """The stage with the folders of all stages that its maps come from."""
        runs = {name: run.folder for name, run in inputs.items()}
        if not (runs["parameterize"] / "predictions").is_dir():
            # A method that learns nothing may share an experiment with one that does.
            runs = {name: place for name, place in runs.items() if name not in TRAINED}
        return cls(folder=folder, runs=runs, **numbers)

    def finish(self) -> dict[str, float]:
        """Write the tables and the page; the metrics are the table's, test before all."""
        super().finish()
        order = {id: place for place, id in enumerate(self.collection.ids())}
        rows: list[Record] = [dict(row) for row in self.rows if not row.get("error")]
        rows.sort(key=lambda row: order[row["id"]])
        pairs = [pair for row in rows for pair in self._pairs(row["id"])]
        pairs.sort(key=lambda pair: (order[pair["first"]], order[pair["second"]]))
        summary = summarize(rows, pairs, self.names, self.neighbours)
        summary["skipped"] = [
            {"id": id, "reason": reason} for id, reason in self.collection.skipped
        ]
        summary["lost"] = self._lost()
        summary["failed"] = self._failed()
        self._write(rows, pairs, summary)
        self._draw(summary)
        return _metrics(summary["groups"])

    def _pairs(self, id: str) -> list[Record]:
        pairs: list[Record] = read_json(pairs_path(self.folder, id))
        return pairs

    def _failed(self) -> list[Row]:
        """Shapes without a map, or whose map could not be evaluated."""
        rows = [*stored_rows(self.runs["parameterize"]), *self.rows]
        return [{"id": row["id"], "error": row["error"]} for row in rows if row.get("error")]

    def _lost(self) -> list[Record]:
        """Training shapes that no registration reached: nothing was learnt from them."""
        path = self.runs.get("correspond", Path()) / "shapes.csv"
        rows = read_rows(path) if "correspond" in self.runs and path.is_file() else []
        return [{"id": row["id"], "reason": row["error"]} for row in rows if row.get("error")]

    def _write(self, rows: list[Record], pairs: list[Record], summary: Record) -> None:
        write_table(self.folder / "shapes.csv", _with_errors(rows, pairs))
        plain = [
            {key: value for key, value in pair.items() if not key.startswith("quantiles")}
            for pair in pairs
        ]
        write_table(self.folder / "pairs.csv", plain)
        write_json(self.folder / "summary.json", without_nan(summary))
        write_text(self.folder / "summary.md", summary_markdown(summary))
        write_text(self.folder / "summary.csv", summary_csv(summary))

    def _draw(self, summary: Record) -> None:
        if self.pictures is None:
            return
        ids = mapped_ids(self.collection, self.runs["parameterize"])
        stored = self.folder / SETTINGS
        draw_all(
            self.folder,
            runs=self.runs,
            splits=self.collection.splits(ids),
            collection=self.names["collection"],
            method=self.names["variant"],
            summary=summary,
            generated=self._generated(ids, self.pictures),
            truth=self.collection.points_in_common,
            others=self._baselines(),
            settings=read_json(stored)["settings"] if stored.is_file() else {},
            options=self.pictures,
        )

    @cached_property
    def _networks(self) -> dict[str, Network]:
        """The model whose maps these are; none of a method that learns nothing."""
        if "finetune" not in self.runs:
            return {}
        return load_model(self.runs["finetune"] / "model.pt")

    def _baselines(self) -> dict[str, Path]:
        """What the maps are shown beside, where the experiment has evaluated any."""
        maps = self.runs["parameterize"].absolute()
        return baselines(maps.parent.parent, besides=maps, count=_BASELINES)

    def _generated(self, ids: Sequence[str], options: PictureOptions) -> Generated:
        """The generator's surfaces on the ways from the sphere to some shapes."""
        if "generator" not in self._networks:
            return Generated()
        generator, frames = self._networks["generator"].eval(), options.frames
        atlas = self._networks.get("atlas")
        straight_on = self._codes(options.chosen(self.collection.splits(ids)))
        along = self._codes(evenly(ids, options.tree_strips))
        return Generated(
            {id: straight(generator, code, frames) for id, code in straight_on.items()},
            dict(self._ways(generator, along, frames)),
            atlas.place if isinstance(atlas, Atlas) else unmoved,
        )

    def _ways(
        self, generator: Network, codes: Mapping[str, np.ndarray], frames: int
    ) -> Iterator[tuple[str, Way]]:
        if "correspond" in self.runs:
            tree = LatentTree.read(self.runs["correspond"], self.runs["finetune"])
            for id, code in codes.items():
                yield id, tree.way(generator, id, code, frames)

    def _codes(self, ids: Sequence[str]) -> dict[str, np.ndarray]:
        """Codes of those that have one."""
        found = {id: prediction(self.runs["parameterize"], id).get("code") for id in ids}
        return {id: code for id, code in found.items() if code is not None}


def _called(collection: ShapeCollection, names: Mapping[str, str]) -> str:
    """The collection in titles; the experiment's name says more than that of any folder."""
    return names["experiment"] if collection.name == FOLDER else collection.name


def _with_errors(rows: list[Record], pairs: list[Record]) -> list[Record]:
    """The rows of the shapes with the mean error of the pairs that each is part of."""
    found: dict[str, list[float]] = {row["id"]: [] for row in rows}
    for pair in pairs:
        if pair["kind"] == "dense":
            found[pair["first"]].append(pair["error"])
            found[pair["second"]].append(pair["error"])
    return [
        {**row, "error": float(np.mean(found[row["id"]])) if found[row["id"]] else None}
        for row in rows
    ]


def _metrics(groups: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """All figures as group/figure; first the implied-correspondence error, else mean σ."""
    order = [group for group in ("test", "all") if group in groups]
    metrics = {f"{group}/{key}": value for group in order for key, value in groups[group].items()}
    first = [f"{order[0]}/{key}" for key in _HEADLINES if f"{order[0]}/{key}" in metrics]
    return {key: metrics[key] for key in [*first, *metrics]}
