"""Stage III-a: other parents for shapes whose edge failed, tried in rounds."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gensp.compute import Row, finished_row, run_items
from gensp.layout import item_folder, lay_out
from gensp.sharing import Workers
from gensp.tasks.correspond import RegisterEdge, ShapeTree, edge_path

Trial = tuple[str, str]  # a child and another parent for it


@dataclass(frozen=True)
class RegisterElsewhere:
    """Register another parent to a child; an item is "child/parent", which no id can contain.

    Every pair has files of its own, so that what was tried does not depend on where a run was
    interrupted.
    """

    edge: RegisterEdge

    def __call__(self, item: str) -> Row:
        """The row of this pair; its edge is written below the parent's folder."""
        child, parent = item.split("/")
        place = _place_of(self.edge.folder, parent)
        return replace(self.edge, folder=place).join(child, parent)


def alternative_folder(folder: Path) -> Path:
    """Where the edges to other parents are tried."""
    return folder / "alternatives"


def alternative_path(folder: Path, child: str, parent: str) -> Path:
    """Where the edge from another parent to `child` is kept."""
    return edge_path(_place_of(folder, parent), child)


def _place_of(folder: Path, parent: str) -> Path:
    return item_folder(alternative_folder(folder), ".", parent) / parent


def alternative_row(folder: Path, child: str, parent: str) -> Row | None:
    """What became of the edge from another parent, or None if it was not tried to the end."""
    return finished_row(alternative_folder(folder), f"{child}/{parent}")


def register_elsewhere(
    edge: RegisterEdge, trials: Sequence[Trial], workers: Workers
) -> dict[Trial, bool]:
    """Which of some other edges are accepted; those of an earlier run are not tried again."""
    items = ["/".join(trial) for trial in trials]
    folder = alternative_folder(edge.folder)
    # Further rounds try more; no more than a few for each shape of the tree.
    lay_out(folder, len(edge.shapes.edges))
    list(run_items(RegisterElsewhere(edge), items, folder, workers))
    rows = {trial: alternative_row(edge.folder, *trial) for trial in trials}
    return {trial: bool(row and row["accepted"]) for trial, row in rows.items()}


def joined_parents(
    shapes: ShapeTree,
    accepted: Collection[str],
    alternatives: int,
    register: Callable[[list[Trial]], Mapping[Trial, bool]],
) -> dict[str, str]:
    """Child → parent of all shapes that hang together with the root, parents first.

    A shape whose own edge failed, or leads from one that stays unreached, tries the nearest
    reached shapes before it in the order of the tree. What is tried in a round depends on the
    results of the rounds before alone: its registrations can share the workers, and a run that is
    resumed repeats the same rounds.

    Parameters
    ----------
    accepted
        Children whose own edge was accepted.
    alternatives
        How many other parents a shape may try.
    register
        Tells of each (child, parent) whether its registration is accepted.
    """
    rounds = _Rounds(shapes, accepted, alternatives)
    while trials := rounds.walk():
        for (child, parent), verdict in register(trials).items():
            rounds.tried.setdefault(child, {})[parent] = verdict
    return rounds.reached


@dataclass
class _Rounds:
    shapes: ShapeTree
    accepted: Collection[str]
    alternatives: int
    tried: dict[str, dict[str, bool]] = field(default_factory=dict)
    reached: dict[str, str] = field(default_factory=dict)

    def walk(self) -> list[Trial]:
        """From the root outward: what is reached so far, and what is to be tried next."""
        self.reached, waiting = {}, set()
        trials: list[Trial] = []
        for child, parent in self.shapes.edges.items():
            joined = self._joined(child, parent)
            if joined is not None:
                self.reached[child] = joined
                continue
            others = [] if child in self.accepted and parent in waiting else self._untried(child)
            trials += [(child, other) for other in others]
            if others or parent in waiting:
                waiting.add(child)
        return trials

    @property
    def _root(self) -> str:
        return self.shapes.ids[self.shapes.tree.order[0]]

    def _joined(self, child: str, parent: str) -> str | None:
        if child in self.accepted and parent in {self._root, *self.reached}:
            return parent
        found = (other for other, verdict in self.tried.get(child, {}).items() if verdict)
        return next(found, None)

    def _untried(self, child: str) -> list[str]:
        """Nearest reached shapes that the child may still try."""
        tried, ids = self.tried.get(child, {}), self.shapes.ids
        known = {self._root, *self.reached} - {self.shapes.edges[child], *tried}
        gap = np.linalg.norm(self.shapes.codes - self.shapes.codes[ids.index(child)], axis=1)
        nearest = [ids[k] for k in np.argsort(gap, kind="stable") if ids[k] in known]
        return nearest[: self.alternatives - len(tried)]
