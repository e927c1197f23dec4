"""The map of the latent space: codes in their two main directions, the spanning tree drawn."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection

from gensp.pictures.curves import figure
from gensp.pictures.montage import SPLIT_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPHERE = "sphere"


def principal_plane(codes: Float[np.ndarray, "k d"]) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (k, 2) of codes in their two main directions, and the variance shares (2,).

    The directions come from the codes centred at their mean; the origin, where the sphere lies,
    stays the origin of the map.
    """
    _, scale, directions = np.linalg.svd(codes - codes.mean(axis=0), full_matrices=False)
    share = scale**2 / max(float((scale**2).sum()), np.finfo(float).tiny)
    # A sign for each direction that does not depend on the decomposition.
    chosen = directions[:2]
    largest = np.take_along_axis(chosen, np.abs(chosen).argmax(axis=1)[:, None], axis=1)
    return codes @ (chosen * np.sign(largest)).T, share[:2]


def latent_map(
    ids: Sequence[str],
    codes: Float[np.ndarray, "k d"],
    splits: Mapping[str, str],
    parents: Mapping[str, str],
    used: frozenset[str] = frozenset(),
) -> "Figure":
    """Inputs, augmented shapes and the sphere in the latent space, with the tree between them.

    Parameters
    ----------
    ids, codes
        Names and latent codes, codes relative to the sphere's.
    splits
        Split of every input shape; other ids count as augmented.
    parents
        Parent of every tree node but the root.
    used
        Children whose edge was registered; drawn darker.
    """
    plane, share = principal_plane(codes)
    place = dict(zip(ids, plane, strict=True)) | {SPHERE: np.zeros(2)}
    drawing = figure(8.0, 6.4)
    panel = drawing.subplots()
    _tree(panel, place, parents, used)
    _points(panel, place, splits)
    panel.set_xlabel(f"first principal direction ({share[0]:.0%} of the variance)")
    panel.set_ylabel(f"second principal direction ({share[1]:.0%})")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False, fontsize=9, loc="best")
    return drawing


def _tree(
    panel: "Axes",
    place: Mapping[str, np.ndarray],
    parents: Mapping[str, str],
    used: frozenset[str],
) -> None:
    known = [(a, b) for a, b in parents.items() if a in place and b in place]
    for registered, colour, width in ((False, "#d9dae0", 0.7), (True, "#6d7385", 1.3)):
        edges = [(place[a], place[b]) for a, b in known if (a in used) == registered]
        panel.add_collection(LineCollection(edges, colors=colour, linewidths=width, zorder=1))


def _points(panel: "Axes", place: Mapping[str, np.ndarray], splits: Mapping[str, str]) -> None:
    groups = {"augmented": [i for i in place if i not in splits and i != SPHERE]}
    for split in SPLIT_COLOURS:
        groups[split] = [i for i in place if splits.get(i) == split]
    for name, members in groups.items():
        if members:
            colour = np.array(SPLIT_COLOURS.get(name, (178, 190, 214))) / 255
            size = 14 if name == "augmented" else 46
            points = np.array([place[i] for i in members])
            x, y = points.T
            panel.scatter(x, y, s=size, color=colour, label=name, zorder=2, linewidths=0)
    panel.scatter(0, 0, s=170, marker="*", color="#1f8a52", label="sphere", zorder=3)
