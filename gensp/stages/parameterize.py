"""Parameterization: a spherical map of every usable shape, by the learnt or a classical method."""

from pathlib import Path

from gensp.compute import Row
from gensp.stages.base import ItemStage


class ParameterizeStage(ItemStage):
    """Passes over the shapes; its ending tells how their maps were made.

    Writes maps/<id>.npz and .ply, predictions/<id>.npz where the method predicts something, and
    maps.csv.

    Parameters
    ----------
    max_failures
        Shapes that may stay without a map.
    """

    def __init__(self, *, max_failures: int = 0, folder: Path | str = Path(".")) -> None:
        super().__init__(table="maps", max_failures=max_failures, folder=folder)

    def finish(self) -> dict[str, float]:
        """Write the table; folds left in the maps come first."""
        counts = super().finish()
        rows = [row for row in self.rows if not row.get("error")]
        return {
            "bad_faces": _sum(rows, "bad_faces"),
            **_starts(rows),
            "folded_maps": sum(bool(row["bad_faces"]) or abs(_degree(row)) != 1 for row in rows),
            # A run's own seconds stand beside it in `gensp runs`.
            "seconds_per_shape": round(_sum(rows, "seconds") / max(len(rows), 1), 4),
            **counts,
        }


def _starts(rows: list[Row]) -> dict[str, float]:
    """Folds before refinement, of a method that begins with a map of the whole shape."""
    known = [row for row in rows if row.get("bad_faces_start") is not None]
    return {"bad_faces_start": _sum(known, "bad_faces_start")} if known else {}


def _sum(rows: list[Row], column: str) -> float:
    return sum(float(row[column] or 0) for row in rows)


def _degree(row: Row) -> int:
    return int(row["degree"] or 0)
