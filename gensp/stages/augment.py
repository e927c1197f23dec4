"""Stage I (paper §4.1): shapes between the inputs and the sphere, by mean curvature flow."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from gensp.compute import Row
from gensp.data.items import item_path
from gensp.data.shapes import ShapeCollection
from gensp.files import load_npz, write_json, write_text
from gensp.geometry.flow import accepted
from gensp.runs import Run
from gensp.stages.base import ItemStage, write_table


class AugmentStage(ItemStage):
    """Passes over the training shapes; its ending applies the rule s < 2δ to all scores.

    Writes meshes/<item>.npz (every input, and its samples "<id>@<k>"), flows/<id>.npz, flows.csv
    (what happened to every shape), items.json (inputs and the samples of accepted flows) and
    skipped.csv (meshes that the collection left out).

    Parameters
    ----------
    skipped
        (id, reason) of meshes that could not be used.
    acceptance
        Flows score below this multiple of the median (paper: 2).
    """

    def __init__(
        self,
        *,
        skipped: Sequence[tuple[str, str]] = (),
        acceptance: float = 2.0,
        max_failures: int = 0,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(table="flows", max_failures=max_failures, folder=folder)
        self.skipped = list(skipped)
        self.acceptance = acceptance

    @classmethod
    def from_runs(
        cls,
        inputs: Mapping[str, Run],
        folder: Path,
        *,
        collection: ShapeCollection | None = None,
        **numbers: Any,
    ) -> Self:
        """The stage for a collection, whose skipped meshes it reports."""
        skipped = [] if collection is None else collection.skipped
        return cls(folder=folder, skipped=skipped, **numbers)

    def finish(self) -> dict[str, float]:
        """Accept flows, list the items, write the tables."""
        counts = super().finish()
        rows = [row for row in self.rows if not row.get("error")]
        rows = self._judged(rows)
        items = [entry for row in rows for entry in self._items(row)]
        failed = [row for row in self.rows if row.get("error")]
        write_table(self.folder / "flows.csv", [*rows, *failed])
        self._write_skipped()
        write_json(self.folder / "items.json", items)
        samples = sum(entry["kind"] == "augmented" for entry in items)
        return {
            "augmented": samples,
            "accepted": sum(bool(row["accepted"]) for row in rows),
            "geometry_only": sum(int(row.get("geometry_only") or 0) for row in rows),
            "skipped": len(self.skipped),
            **counts,
        }

    def _write_skipped(self) -> None:
        path = self.folder / "skipped.csv"
        if self.skipped:
            write_table(path, [{"id": id, "reason": reason} for id, reason in self.skipped])
        else:
            write_text(path, "id,reason\n")

    def _judged(self, rows: list[Row]) -> list[Row]:
        scores = np.array([np.inf if row["score"] is None else row["score"] for row in rows])
        verdicts = accepted(scores, self.acceptance)
        return [
            {**row, "accepted": bool(verdict)} for row, verdict in zip(rows, verdicts, strict=True)
        ]

    def _items(self, row: Row) -> list[dict[str, Any]]:
        """The input, and its samples if its flow was accepted."""
        shared = {"shape": row["id"], "split": row["split"]}
        items = [{"id": row["id"], **shared, "kind": "input", "t": 0.0}]
        if row["accepted"]:
            for path in self._samples(row):
                t = float(load_npz(path)["t"])
                items.append({"id": path.stem, **shared, "kind": "augmented", "t": t})
        return items

    def _samples(self, row: Row) -> list[Path]:
        """Those that were not dropped, looked for one by one: a folder may hold all shapes."""
        drawn = int(row.get("kept") or 0) + int(row.get("dropped") or 0)
        paths = [item_path(self.folder, f"{row['id']}@{k}") for k in range(drawn)]
        return [path for path in paths if path.is_file()]
