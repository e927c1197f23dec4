"""Methods side by side: distortion against error, and how large the distortion gets."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gensp.pictures.curves import figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Beyond it a map is of no use, and the axis would hide what differs below.
_LARGEST = 1e3
_MARKERS = "osD^vP*X<>"


@dataclass(frozen=True)
class MethodFigures:
    """What is drawn of one method.

    Attributes
    ----------
    sigma_mean, error
        Means over the collection; none where there is no figure.
    sigma_max
        Of every shape with a map.
    failures
        Shapes without one: the curve ends below 1.
    """

    label: str
    sigma_mean: float | None
    error: float | None
    sigma_max: Sequence[float]
    failures: int = 0


def methods_figure(methods: Sequence[MethodFigures]) -> "Figure":
    """Mean σ against the error if there is one, and the share of shapes below a largest σ."""
    compared = [m for m in methods if m.error is not None and m.sigma_mean is not None]
    drawing = figure(9.6 if compared else 5.4, 3.8)
    panels = drawing.subplots(1, 2 if compared else 1, squeeze=False)[0]
    colours = {m.label: f"C{place % 10}" for place, m in enumerate(methods)}
    if compared:
        _scatter(panels[0], compared, colours)
    _curves(panels[-1], methods, colours)
    return drawing


def _scatter(panel: "Axes", methods: Sequence[MethodFigures], colours: dict[str, str]) -> None:
    for place, label in enumerate(colours):
        for method in (m for m in methods if m.label == label):
            panel.plot(
                [method.error],
                [method.sigma_mean],
                _MARKERS[place % len(_MARKERS)],
                color=colours[label],
                markersize=8,
                label=label,
            )
    panel.set(xlabel="error (registered) / √area", ylabel="mean σ")
    panel.margins(0.12)
    plain(panel)


def _curves(panel: "Axes", methods: Sequence[MethodFigures], colours: dict[str, str]) -> None:
    for method in methods:
        largest = np.sort(np.asarray(method.sigma_max, dtype=float))
        share = np.arange(1, len(largest) + 1) / (len(largest) + method.failures)
        panel.step(largest, share, where="post", color=colours[method.label], label=method.label)
    ends = [value for m in methods for value in m.sigma_max if value <= _LARGEST]
    panel.set_xscale("log")
    panel.set(xlabel="largest σ of a shape", ylabel="share of shapes below", ylim=(0, 1.02))
    panel.set_xlim(right=1.1 * max(ends, default=_LARGEST))
    plain(panel)
