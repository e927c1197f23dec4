"""Before all stages: a raw collection becomes one that can be learnt from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from gensp.card import write_card
from gensp.compute import Row
from gensp.data.folder import COLUMNS
from gensp.data.raw import RawCollection
from gensp.errors import MissingData
from gensp.files import read_json, write_json
from gensp.geometry.preparation import DROPPED, REPAIRED
from gensp.runs import Run
from gensp.stages.base import ItemStage, write_table
from gensp.tasks.prepare import KINDS, prepared_path

_DROPPED = ("id", "reason", "remedy", "found", "source")
_TOLD = ("verdict", "found", "done", "hausdorff", "vertices", "faces", "truth_moved")


class PrepareStage(ItemStage):
    """Passes over the meshes; its ending makes a collection of the usable ones.

    Writes meshes/<id>.ply, corr/<id>.npz, keypoints.json, manifest.csv, which `shapes=folder`
    reads; dropped.csv (what was left out and why), misaligned.csv (models whose keypoints do not
    lie on them or cannot be read), prepared.csv (a row for every mesh) and the data card.

    A mesh that was given up, because workers died of it or met an error, is dropped as others are.
    """

    def __init__(
        self, *, collection: RawCollection | None = None, folder: Path | str = Path(".")
    ) -> None:
        super().__init__(table="prepared", max_failures=None, folder=folder)
        self.collection = collection

    @classmethod
    def from_runs(
        cls,
        inputs: Mapping[str, Run],
        folder: Path,
        *,
        collection: RawCollection | None = None,
        **numbers: Any,
    ) -> Self:
        """The stage for a raw collection."""
        return cls(folder=folder, collection=collection, **numbers)

    @property
    def rows(self) -> list[Row]:
        """The rows of all items; of those given up the verdict and the reason."""
        return [_dropped(row) if row.get("error") else row for row in super().rows]

    def finish(self) -> dict[str, float]:
        """Write the collection's tables and its card.

        Raises
        ------
        MissingData
            No mesh is usable.
        """
        assert self.collection is not None
        counts = super().finish()
        rows = {str(row["id"]): row for row in self.rows}
        ordered = [rows[id] for id in self.collection.ids() if id in rows]
        kept = [row for row in ordered if row["verdict"] != DROPPED]
        dropped = [row for row in ordered if row["verdict"] == DROPPED]
        self._write_dropped(dropped)
        self._remove_rests([str(row["id"]) for row in dropped if row.get("error")])
        if not kept:
            raise MissingData(
                f"{self.folder}: none of {len(ordered)} meshes can be used, the first because of "
                f"{dropped[0]['reason'] if dropped else 'nothing'}; one closed genus-0 surface is "
                f"required; {self.folder / 'dropped.csv'} tells what mends each"
            )
        used = self._write_collection(kept)
        write_card(self.folder, name=self.collection.name, up=self.collection.up)
        repaired = sum(row["verdict"] == REPAIRED for row in kept)
        told = {"kept": len(kept), "repaired": repaired, "dropped": len(dropped)}
        told["failed"] = counts["failed"]
        told |= {"used": used} if used < len(kept) else {}
        return {**told, "cached": sum(bool(row.get("cached")) for row in ordered), **counts}

    def _write_dropped(self, dropped: list[Row]) -> None:
        rows = [
            {key: {**self._columns(row), **row}.get(key, "") for key in _DROPPED}
            for row in dropped
        ]
        write_table(self.folder / "dropped.csv", rows, columns=_DROPPED)

    def _remove_rests(self, failed: list[str]) -> None:
        """What workers had written of a mesh before they died of it is no part of a collection."""
        for path in (prepared_path(self.folder, kind, id) for kind in KINDS for id in failed):
            path.unlink(missing_ok=True)

    def _write_collection(self, kept: list[Row]) -> int:
        """Write the tables of the meshes that have a split; their number."""
        assert self.collection is not None
        splits = self.collection.splits([str(row["id"]) for row in kept])
        kept = [row for row in kept if str(row["id"]) in splits]
        records = [prepared_path(self.folder, "keypoints", str(row["id"])) for row in kept]
        found = {path.stem: read_json(path) for path in records if path.is_file()}
        if found:
            write_json(self.folder / "keypoints.json", list(found.values()))
        self._write_misaligned(kept)
        entries = [self._entry(row, splits, str(row["id"]) in found) for row in kept]
        write_table(self.folder / "manifest.csv", entries)
        return len(kept)

    def _write_misaligned(self, kept: list[Row]) -> None:
        """List the models whose keypoints are not used, if there are any."""
        assert self.collection is not None
        unread = self.collection.unread_keypoints()
        off = [
            {"id": row["id"], "keypoints_off": row["keypoints_off"], "reason": "off the surface"}
            for row in kept
            if row.get("misaligned")
        ]
        bad = [
            {
                "id": row["id"],
                "keypoints_off": "",
                "reason": f"cannot be read: {unread[row['id']]}",
            }
            for row in kept
            if row["id"] in unread
        ]
        if off or bad:
            write_table(self.folder / "misaligned.csv", [*off, *bad])

    def _entry(self, row: Row, splits: Mapping[str, str], keypoints: bool) -> dict[str, Any]:
        """The manifest's row of a mesh."""
        id = str(row["id"])
        known = self._columns(row)
        dense = [self._name("corr", id)] * (row.get("truth") is not None)
        return {
            "file": self._name("meshes", id),
            "split": splits[id],
            **{key: known.get(key, "") for key in COLUMNS},
            "correspondence": ";".join([*dense, *["keypoints.json"] * keypoints]),
            "genus": 0,
            **{key: row.get(key, "") for key in _TOLD},
        }

    def _name(self, kind: str, id: str) -> str:
        """A file as the manifest names it: from the collection's folder."""
        return prepared_path(self.folder, kind, id).relative_to(self.folder).as_posix()

    def _columns(self, row: Row) -> dict[str, str]:
        assert self.collection is not None
        return self.collection.columns(str(row["id"]))


def _dropped(row: Row) -> Row:
    """The row of a mesh that was given up, as that of one which cannot be used."""
    reason = str(row["error"]).removeprefix(f"{row['id']}: ")
    return {"id": row["id"], "verdict": DROPPED, "reason": reason, "error": row["error"]}
