"""The figure of one test: truth, reference and the student's curve, and where it left the band.

In the text that goes with it the same is said in numbers, because not everybody sees the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.report.figures import style

Role = Literal["truth", "reference", "yours", "band"]

_LOOK: dict[Role, dict[str, Any]] = {
    "truth": {"color": style.TRUTH, "linewidth": 1.6},
    "reference": {"color": style.PALETTE[0], "linewidth": 1.6, "linestyle": "--"},
    "yours": {"color": style.PALETTE[1], "linewidth": 1.8},
    "band": {"color": "#777777", "linewidth": 0.7},
}
_ORDER: tuple[Role, ...] = ("band", "truth", "reference", "yours")


@dataclass(frozen=True)
class Curve:
    """One curve; a band is two of them, its lower and its upper border, or its upper border alone."""

    name: str
    y: Sequence[float]
    role: Role
    x: Sequence[float] | None = None
    """Of its own; None: the figure's."""


def plot_curves(
    title: str,
    x_label: str,
    y_label: str,
    x: Sequence[float],
    curves: Sequence[Curve],
    *,
    equal_scales: bool = False,
) -> Figure:
    """The figure; what of the student's curves lies outside the band is marked.

    A band belongs to the figure's own x. With equal scales a circle stays a circle, as in a map.
    """
    with matplotlib.rc_context(style.RC):
        along = np.asarray(x, dtype=float)
        frame = _frame([curve for curve in curves if curve.role in ("truth", "reference")], along)
        height = 3.4
        if equal_scales and len(frame) == 2:
            height = 1.0 + float(np.clip(6.2 * np.ptp(frame["ylim"]) / np.ptp(frame["xlim"]), 2.4, 6.0))
        figure = style.new_figure(7.2, height, _no_mathtext(title))
        axes = figure.add_subplot()
        handles: dict[str, Any] = {}
        lower, upper = _band(curves, along.size)
        if lower is not None and upper is not None:
            # Without a lower border the curve is a size, which begins at nought.
            floor = np.where(np.isneginf(lower), np.minimum(0.0, upper), lower)
            axes.fill_between(along, floor, upper, color=style.BAND, alpha=0.45, linewidth=0)
        for curve in sorted(curves, key=lambda each: _ORDER.index(each.role)):
            look = _LOOK[curve.role]
            own = along if curve.x is None else _finite(curve.x, len(curve.x))
            y = _finite(curve.y, own.size)
            axes.plot(own, y, **look)
            handles.setdefault(curve.name, style.line_key(_no_mathtext(curve.name), **look))
            if curve.role == "yours" and curve.x is None and lower is not None and upper is not None:
                outside = (y < lower) | (y > upper)
                if outside.any():
                    mark: dict[str, Any] = {
                        "color": "#B3261E",
                        "marker": "x",
                        "markersize": 6,
                        "linestyle": "",
                    }
                    axes.plot(along[outside], y[outside], **mark)
                    handles.setdefault("outside the band", style.line_key("outside the band", **mark))
        axes.set_xlabel(_no_mathtext(x_label))
        axes.set_ylabel(_no_mathtext(y_label))
        if equal_scales:
            axes.set(aspect="equal", **frame)
        style.legend_below(figure, list(handles.values()), columns=4)
    return figure


def outside_text(x_label: str, x: Sequence[float], curves: Sequence[Curve]) -> str:
    """Where the student's curve lies outside the band, in words; empty without a band."""
    along = np.asarray(x, dtype=float)
    lower, upper = _band(curves, along.size)
    yours = [curve for curve in curves if curve.role == "yours" and curve.x is None]
    if lower is None or upper is None or not yours:
        return ""
    y = _finite(yours[0].y, along.size)
    known = np.isfinite(y) & ~np.isnan(lower) & np.isfinite(upper)
    outside = known & ((y < lower) | (y > upper))
    if not known.any():
        return "There is nothing of your curve to compare."
    if not outside.any():
        return f"Your curve stays inside the band at all {int(known.sum())} points."
    first = int(np.flatnonzero(outside)[0])
    share = f"{int(outside.sum())} of {int(known.sum())} points"
    border = f"{upper[first]:.4g}"
    border = f"up to {border}" if np.isneginf(lower[first]) else f"{lower[first]:.4g} to {border}"
    return (
        f"Your curve first leaves the band at {x_label} = {along[first]:.4g} "
        f"(value {y[first]:.4g}, band {border}) and is outside at {share}."
    )


def _frame(right: Sequence[Curve], along: NDArray[np.float64]) -> dict[str, tuple[float, float]]:
    """Limits with the right curves and room for more: one that ran away would make them a dot."""
    frame: dict[str, tuple[float, float]] = {}
    for index, limits in enumerate(("xlim", "ylim")):
        each = [(along if curve.x is None else curve.x, curve.y)[index] for curve in right]
        values = np.concatenate([np.empty(0), *(np.asarray(one, dtype=float) for one in each)])
        values = values[np.isfinite(values)]
        if values.size:
            room = 0.25 * max(float(np.ptp(values)), 1e-3)
            frame[limits] = (float(values.min()) - room, float(values.max()) + room)
    return frame


def _band(
    curves: Sequence[Curve], size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | tuple[None, None]:
    borders = [_finite(curve.y, size) for curve in curves if curve.role == "band"]
    if len(borders) == 1:
        return np.where(np.isnan(borders[0]), np.nan, -np.inf), borders[0]
    if len(borders) != 2:
        return None, None
    return np.minimum(*borders), np.maximum(*borders)


def _finite(values: Sequence[float], size: int) -> NDArray[np.float64]:
    """As many values as there are abscissae; what is missing or cannot be drawn is a gap."""
    given = np.asarray(values, dtype=float)[:size]
    y = np.full(size, np.nan)
    drawable = np.isfinite(given) & (np.abs(given) < 1e100)
    y[: given.size][drawable] = given[drawable]
    return y


def _no_mathtext(text: str) -> str:
    """A submission chooses names of its own, and half a formula is an error of matplotlib's."""
    return text.replace("$", r"\$")
