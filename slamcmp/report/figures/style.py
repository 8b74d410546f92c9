"""One look for every figure: a colour and a marker per back end, sizes, legends outside the data."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from slamcmp.results.grid import labels
from slamcmp.results.store import Results

# Okabe and Ito 2008, "Color Universal Design"; black and grey are kept for the truth and for bands. Their
# yellow is too pale for thin lines on white; Tol's olive (2021, "Colour schemes", muted) stands in its place.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#999933")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
TRUTH = "#000000"
BAND = "#BBBBBB"

PAGE_DPI = 72

LINES: dict[str, str] = {"online": "--", "final": "-"}

RC: Any = {
    "svg.hashsalt": "slamcmp",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "figure.titlesize": 11.5,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}


def colours(results: Results) -> dict[str, str]:
    """The colour of each back end, the same in every figure of a results folder."""
    return {label: PALETTE[i % len(PALETTE)] for i, label in enumerate(labels(results))}


def markers(results: Results) -> dict[str, str]:
    """The marker of each back end, so that no figure depends on colour alone."""
    return {label: MARKERS[(i + i // len(PALETTE)) % len(MARKERS)] for i, label in enumerate(labels(results))}


def widths(results: Results) -> dict[str, float]:
    """Line widths that shrink in drawing order: where two back ends agree, the lower one stays visible."""
    known = labels(results)
    return {label: (1.0, 1.8, 2.4, 3.0)[min(3, len(known) - 1 - i)] for i, label in enumerate(known)}


class PageFigure(Figure):
    """A figure that also shows itself in a notebook, where nobody has asked for pyplot."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """PNG with two pixels for each of the page's, and the size on the page."""
        buffer = io.BytesIO()
        with matplotlib.rc_context(RC):
            self.savefig(buffer, format="png", dpi=2 * PAGE_DPI)
        width, height = (round(PAGE_DPI * inches) for inches in self.get_size_inches())
        return buffer.getvalue(), {"width": width, "height": height}


def new_figure(width: float, height: float, title: str) -> PageFigure:
    """An empty figure [inch] with its title at the left."""
    figure = PageFigure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    return figure


def legend_below(figure: Figure, handles: Sequence[Any], columns: int = 6) -> None:
    """One legend for the whole figure, under the axes."""
    figure.legend(handles=list(handles), loc="outside lower left", ncols=min(columns, len(handles)))


def line_key(label: str, **options: Any) -> Line2D:
    """A legend entry that belongs to no axes."""
    return Line2D([], [], label=label, **options)


def log_if_wide(axes: Axes, values: NDArray[np.float64], axis: str = "y", ratio: float = 8.0) -> None:
    """Logarithmic axis where positive values span more than ``ratio``."""
    values = values[np.isfinite(values)]
    if values.size and values.min() > 0 and values.max() > ratio * values.min():
        log_axis(axes, axis)


def log_axis(axes: Axes, axis: str = "y") -> None:
    """Logarithmic axis with plain numbers (0.3 instead of 3·10⁻¹)."""
    (axes.set_yscale if axis == "y" else axes.set_xscale)("log")
    ruler = axes.yaxis if axis == "y" else axes.xaxis
    ruler.set_major_formatter(PlainLog())
    ruler.set_minor_formatter(PlainLog(minor_thresholds=(1.3, 0.5)))


class PlainLog(LogFormatter):
    """Ticks of a logarithmic axis as plain numbers."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""
