"""What one frame costs, over the run and against the size of the map."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import at_point, has_values, labels, middle_point, point_name
from slamcmp.results.store import Results

BINS = 60
LONG = 1000
"""Frames of a run from which on the law of its cost is fitted."""


@figures.register(
    "time",
    title="Time per frame",
    needs=("frames: update_s, estimate_s", "optional: landmarks"),
    caption=(
        "Wall time of a frame, in groups of neighbouring frames (left) or of equal map size (right, over "
        "all grid points). Line: median; pale line: 95th percentile. Update and estimate are apart, "
        "because recovering a covariance can cost a smoother more than its update. Dashed, in runs of 1000 "
        "frames and more: the law a k^b that fits the medians of the second half; b stands in the legend, "
        "and near 0 the cost no longer grows. One BLAS thread."
    ),
)
def plot_time(results: Results) -> Figure:
    """Median and 95th percentile of update and estimate time against frame and map size."""
    frames = results.frames
    if not has_values(frames, ["update_s"]):
        raise NotDrawable("no run has times")
    point = middle_point(results)
    here = at_point(frames, point)
    sized = has_values(frames, ["landmarks"])
    kinds = [name for name in ("update_s", "estimate_s") if has_values(frames, [name])]
    where = point_name(point)
    figure = style.new_figure(9.5, 2.7 * len(kinds) + 0.9, "What a frame costs")
    grid = figure.subplots(len(kinds), 1 + sized, sharex="col", sharey="row", squeeze=False)
    for row, kind in enumerate(kinds):
        _draw_times(grid[row, 0], results, here, "k", kind)
        grid[row, 0].set_ylabel(f"{kind.removesuffix('_s')} [ms]")
        if sized:
            _draw_times(grid[row, 1], results, frames.dropna(subset=["landmarks"]), "landmarks", kind)
    grid[0, 0].set_title("over the run" + (f" ({where})" if where else ""))
    grid[-1, 0].set_xlabel("frame")
    if sized:
        grid[0, 1].set_title("against the size of the map")
        grid[-1, 1].set_xlabel("landmarks in the map")
    colours = style.colours(results)
    laws = _laws_in_words(here, kinds)
    keys = [style.line_key(label + laws.get(label, ""), color=colours[label]) for label in labels(results)]
    style.legend_below(figure, keys, columns=2 if laws else 6)
    return figure


def binned_times(
    table: pd.DataFrame, against: str, kind: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Positions, medians and 95th percentiles [ms] of at most 60 groups along ``against``."""
    values = table[against].to_numpy(dtype=float)
    low, high = values.min(), values.max()
    size = max(1.0, (high - low + 1) / BINS)
    groups = np.floor((values - low) / size)
    milliseconds = table[kind] * 1e3
    positions = table[against].groupby(groups).mean()
    times = milliseconds.groupby(groups)
    return (
        positions.to_numpy(dtype=float),
        times.median().to_numpy(dtype=float),
        times.quantile(0.95).to_numpy(dtype=float),
    )


def fitted_law(
    position: NDArray[np.float64], median: NDArray[np.float64]
) -> tuple[float, float, NDArray[np.bool_]] | None:
    """a [ms] and b of ``a k^b``, by least squares on logarithms over the second half of the frames; where.

    None where the run is shorter than :data:`LONG`, or costs nothing that a clock could see.
    """
    late = (position >= position.max() / 2) & (median > 0)
    # Positions are the middles of groups: half of the first is before it, half of the last behind it.
    if position.min() + position.max() + 1 < LONG or late.sum() < 3:
        return None
    b, log_a = np.polyfit(np.log(position[late]), np.log(median[late]), 1)
    return float(np.exp(log_a)), float(b), late


def _laws_in_words(table: pd.DataFrame, kinds: list[str]) -> dict[str, str]:
    """For the legend: of each back end with a long run the exponents, ``: update k^0.9, estimate k^0.0``."""
    told = {}
    for label, own in table.groupby("label"):
        laws = [(kind, fitted_law(*binned_times(own, "k", kind)[:2])) for kind in kinds]
        words = [
            # No minus before a zero.
            f"{kind.removesuffix('_s')} $k^{{{round(law[1], 1) + 0.0:.1f}}}$"
            for kind, law in laws
            if law is not None
        ]
        if words:
            told[str(label)] = f": {', '.join(words)}"
    return told


def _draw_times(axes: Axes, results: Results, table: pd.DataFrame, against: str, kind: str) -> None:
    for label, colour in style.colours(results).items():
        own = table[table["label"] == label]
        if own.empty:
            continue
        position, median, high = binned_times(own, against, kind)
        axes.plot(position, high, color=colour, alpha=0.4, linewidth=0.8)
        axes.plot(position, median, color=colour, linewidth=style.widths(results)[label])
        law = fitted_law(position, median) if against == "k" else None
        if law is not None:
            a, b, late = law
            axes.plot(position[late], a * position[late] ** b, color=colour, linewidth=1.2, linestyle="--")
    style.log_axis(axes)
