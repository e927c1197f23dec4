"""Methods side by side: distortion against error, and how large the distortion gets."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gensp.pictures.curves import decade_ticks, figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# Beyond it a map is of no use, and the axis would hide what differs below.
_LARGEST = 1e3
_MANY = 10  # times the smallest: from there on an axis is logarithmic
_MARKERS = "osD^vP*X<>"
# A method looks alike in all figures, whatever stands beside it; learnt ones take what is left.
_PLACES = {
    name: place
    for place, name in enumerate(
        ("dirichlet", "stretch", "ahsp", "smat", "arap", "cmcf", "cmcf_raw", "vc25")
    )
}


@dataclass(frozen=True)
class MethodFigures:
    """What is drawn of one method.

    Attributes
    ----------
    sigma_mean, error, rotated
        Means over the collection, the error without a rotation and with the best one; none where
        there is no figure.
    sigma_max
        Of every shape with a map.
    failures
        Shapes without one: the curve ends below 1.
    curves
        Of the summary of every seed: thresholds, and the fractions below them.
    """

    label: str
    sigma_mean: float | None
    error: float | None
    sigma_max: Sequence[float]
    failures: int = 0
    rotated: float | None = None
    curves: Sequence[Mapping[str, Any]] = ()

    @property
    def bounded(self) -> bool:
        """Whether its mean σ can be drawn."""
        return self.sigma_mean is not None and bool(np.isfinite(self.sigma_mean))


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


_TURNED = {
    "raw": "Euclidean, no rotation",
    "rotated": "Euclidean, best rotation",
    "geodesic_raw": "geodesic, no rotation",
    "geodesic_rotated": "geodesic, best rotation",
}


def curves_figure(methods: Sequence[MethodFigures], splits: Sequence[str]) -> "Figure":
    """Fraction of points whose error is below x: a row for every split that has any."""
    shown = [s for s in splits if any(s in curve for m in methods for curve in m.curves)]
    drawing = figure(15.6, 0.4 + 2.9 * len(shown))
    grid = drawing.subplots(len(shown), len(_TURNED), squeeze=False, sharex=True, sharey=True)
    for panels, split in zip(grid, shown, strict=True):
        for panel, (kind, words) in zip(panels, _TURNED.items(), strict=True):
            _fractions(panel, methods, split, kind)
            panel.set_title(f"{split} shapes, {words}", loc="left", fontsize=10)
        panels[0].set_ylabel("fraction of points below")
    for panel in grid[-1]:
        panel.set_xlabel("error / √area")
    drawing.legend(handles=_handles(methods), loc="outside right center", frameon=False)
    return drawing


def _fractions(panel: "Axes", methods: Sequence[MethodFigures], split: str, kind: str) -> None:
    styles = _styles(methods)
    for method in methods:
        lines = [c[split][kind] for c in method.curves if kind in c.get(split, {})]
        if lines:
            thresholds, style = (
                method.curves[0]["thresholds"],
                {**styles[method.label], "marker": ""},
            )
            panel.plot(thresholds, np.mean(lines, axis=0), label=method.label, **style)
    panel.set(ylim=(0, 1.02))
    panel.set_xlim(left=0)
    plain(panel, legend=False)


def _styles(methods: Sequence[MethodFigures]) -> dict[str, dict[str, str]]:
    """Colour and marker of every label."""
    free = itertools.count(len(_PLACES))
    places: dict[str, int] = {}
    for method in methods:
        own = _PLACES.get(method.label.split("+")[0])
        taken = own is None or own in places.values()
        places[method.label] = next(free) if taken else own
    return {
        label: {"color": f"C{place % 10}", "marker": _MARKERS[place % len(_MARKERS)]}
        for label, place in places.items()
    }


def _handles(methods: Sequence[MethodFigures]) -> list["Line2D"]:
    from matplotlib.lines import Line2D

    styles = _styles(methods)
    labels = {m.label: m.label if m.bounded else f"{m.label} (mean σ = ∞)" for m in methods}
    return [Line2D([], [], label=told, **styles[label]) for label, told in labels.items()]


def _scatter(panel: "Axes", methods: Sequence[MethodFigures]) -> None:
    """A mark at the error without a rotation, and a line to that with the best one."""
    styles = _styles(methods)
    for method in methods:
        if method.error is None or not method.bounded:
            continue
        style = styles[method.label]
        if method.rotated is not None:
            ends, height = [method.error, method.rotated], [method.sigma_mean] * 2
            panel.plot(ends, height, **{**style, "marker": "|"}, markersize=8, linewidth=1)
        panel.plot([method.error], [method.sigma_mean], markersize=8, **style)
    heights = [m.sigma_mean for m in methods if m.sigma_mean and m.bounded]
    places = [x for m in methods for x in (m.error, m.rotated) if x and m.bounded]
    # One method far off must not press the others together.
    if heights and max(heights) > _MANY * min(heights):
        panel.set_yscale("log")
        decade_ticks(panel.yaxis)
    if places and max(places) > _MANY * min(places):
        panel.set_xscale("log")
        decade_ticks(panel.xaxis)
    panel.set(xlabel="error / √area, no rotation (bar: the best one)", ylabel="mean σ")
    panel.margins(0.12)
    plain(panel, legend=False)


def _curves(panel: "Axes", methods: Sequence[MethodFigures]) -> None:
    styles = _styles(methods)
    for method in methods:
        largest = np.sort(np.asarray(method.sigma_max, dtype=float))
        share = np.arange(1, len(largest) + 1) / (len(largest) + method.failures)
        style = {**styles[method.label], "marker": ""}
        panel.step(largest, share, where="post", label=method.label, **style)
    ends = [value for m in methods for value in m.sigma_max if value <= _LARGEST]
    panel.set_xscale("log")
    decade_ticks(panel.xaxis)
    panel.set(xlabel="largest σ of a shape", ylabel="share of shapes below", ylim=(0, 1.02))
    panel.set_xlim(1, 1.1 * max(ends, default=_LARGEST))  # no σ is below 1
    plain(panel, legend=False)
