"""Methods side by side: distortion against error, and how large the distortion gets."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gensp.pictures.curves import figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# Beyond it a map is of no use, and the axis would hide what differs below.
_LARGEST = 1e3
_MANY = 10  # times the smallest mean σ: from there on its axis is logarithmic
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
    compared = any(m.error is not None for m in methods)
    drawing = figure(10.4 if compared else 6.2, 3.6)
    panels = drawing.subplots(1, 2 if compared else 1, squeeze=False)[0]
    if compared:
        _scatter(panels[0], methods)
    _curves(panels[-1], methods)
    drawing.legend(handles=_handles(methods), loc="outside right center", frameon=False)
    return drawing


def _style(place: int) -> dict[str, str]:
    return {"color": f"C{place % 10}", "marker": _MARKERS[place % len(_MARKERS)]}


def _handles(methods: Sequence[MethodFigures]) -> list["Line2D"]:
    from matplotlib.lines import Line2D

    return [Line2D([], [], label=m.label, **_style(place)) for place, m in enumerate(methods)]


def _scatter(panel: "Axes", methods: Sequence[MethodFigures]) -> None:
    for place, method in enumerate(methods):
        if method.error is not None and method.sigma_mean is not None:
            panel.plot([method.error], [method.sigma_mean], markersize=8, **_style(place))
    heights = [m.sigma_mean for m in methods if m.sigma_mean and np.isfinite(m.sigma_mean)]
    # One method without bound must not press the others together.
    if heights and max(heights) > _MANY * min(heights):
        panel.set_yscale("log")
    panel.set(xlabel="error (registered) / √area", ylabel="mean σ")
    panel.margins(0.12)
    plain(panel, legend=False)


def _curves(panel: "Axes", methods: Sequence[MethodFigures]) -> None:
    from matplotlib.ticker import LogLocator

    for place, method in enumerate(methods):
        largest = np.sort(np.asarray(method.sigma_max, dtype=float))
        share = np.arange(1, len(largest) + 1) / (len(largest) + method.failures)
        style = {**_style(place), "marker": ""}
        panel.step(largest, share, where="post", label=method.label, **style)
    ends = [value for m in methods for value in m.sigma_max if value <= _LARGEST]
    panel.set_xscale("log")
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter("")
    panel.set(xlabel="largest σ of a shape", ylabel="share of shapes below", ylim=(0, 1.02))
    panel.set_xlim(right=1.1 * max(ends, default=_LARGEST))
    plain(panel, legend=False)
