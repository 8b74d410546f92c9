"""Accuracy bought with time: the error of each back end against what a frame costs."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import (
    grid_points,
    has_values,
    labels,
    milliseconds_per_frame,
    reference_name,
    swept_columns,
)
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words

MARKS = "Each small mark is a run, each large one the median {of}with the quartiles over its runs"
REST = (
    "Lower and further left is better. Online and final are apart: a causal answer is not to be measured "
    "against hindsight. Online pays for updates and estimates, final for updates and the last full solution. "
    "Failed runs are not in the medians."
)


def _caption(results: Results) -> str:
    if len(grid_points(results.trials)) == 1:
        return f"{MARKS.format(of='')}. {REST}"
    return f"{MARKS.format(of='of a grid point ')}; the points of a sweep are joined. {REST}"


@figures.register(
    "budget",
    title="Accuracy against time",
    needs=("trials: online_ate or final_ate", "trials: update_s, estimate_s, final_s"),
    caption=f"{MARKS.format(of='of a grid point ')}; the points of a sweep are joined. {REST}",
    caption_of=_caption,
)
def plot_budget(results: Results) -> Figure:
    """ATE against time per frame, online and final in panels of their own."""
    trials = results.trials[results.trials["status"] == "ok"]
    kinds = [which for which in ("online", "final") if has_values(trials, [f"{which}_ate"])]
    if not kinds:
        raise NotDrawable("no finished run has an ATE: the log has no truth and no reference was named")
    if not has_values(trials, ["update_s"]):
        raise NotDrawable("no run has times")
    reference = reference_name(results)
    joined = swept_columns(trials)
    title = "What does accuracy cost?" + (
        f" Joined: {' and '.join(parameters_in_words(joined).values())}" if joined else ""
    )
    figure = style.new_figure(4.75 * len(kinds) + 0.5, 4.4, title)
    grid = figure.subplots(1, len(kinds), sharex=True, sharey=True, squeeze=False)[0]
    shown: set[str] = set()
    tables = {which: budget_points(trials, which) for which in kinds}
    for which, axes in zip(kinds, grid, strict=True):
        shown |= _draw_budget(axes, results, tables[which])
        times = "update + estimate" if which == "online" else "update + final solution"
        axes.set_xlabel(f"{times} [ms per frame]")
        axes.set_title(f"{which} trajectory ({'causal' if which == 'online' else 'with hindsight'})")
    every = pd.concat(tables.values())
    for axes in grid:
        style.log_if_wide(axes, every["ms"].to_numpy(dtype=float), "x", 4.0)
        style.log_if_wide(axes, every["error_m"].to_numpy(dtype=float), "y")
    grid[0].set_ylabel("ATE [m]" if reference == "truth" else f"ATE [m] against {reference}")
    colours, markers = style.colours(results), style.markers(results)
    style.legend_below(
        figure,
        [
            style.line_key(label, color=colours[label], marker=markers[label], linestyle="")
            for label in labels(results)
            if label in shown
        ],
    )
    return figure


def budget_points(trials: pd.DataFrame, which: str) -> pd.DataFrame:
    """Error [m] and time per frame [ms] of each finished run; the reference itself is left out."""
    times = ("update_s", "estimate_s") if which == "online" else ("update_s", "final_s")
    table = trials.assign(error_m=trials[f"{which}_ate"], ms=milliseconds_per_frame(trials, *times))
    itself = (table["reference"] == table["label"] + " (final)") & (which == "final")
    return table[table["error_m"].notna() & table["ms"].notna() & ~itself]


def _draw_budget(axes: Axes, results: Results, table: pd.DataFrame) -> set[str]:
    colours, markers = style.colours(results), style.markers(results)
    for label, own in table.groupby("label", sort=False):
        colour, marker = colours[str(label)], markers[str(label)]
        axes.plot(own["ms"], own["error_m"], marker, color=colour, alpha=0.3, markersize=3.5, mew=0)
        points = own.groupby(swept_columns(own) or "label", sort=False, dropna=False)
        quartiles = points[["ms", "error_m"]].quantile(np.array([0.25, 0.5, 0.75]))
        # As arrays: matplotlib's errorbar takes no Series of one value from pandas 2 without a warning.
        low, middle, high = (
            quartiles.xs(share, level=-1).to_numpy(dtype=float) for share in (0.25, 0.5, 0.75)
        )
        axes.errorbar(
            middle[:, 0],
            middle[:, 1],
            xerr=[middle[:, 0] - low[:, 0], high[:, 0] - middle[:, 0]],
            yerr=[middle[:, 1] - low[:, 1], high[:, 1] - middle[:, 1]],
            color=colour,
            marker=marker,
            markersize=5.0 + 2.0 * style.widths(results)[str(label)],
            markeredgecolor="white",
            linewidth=0.8,
            linestyle="",
        )
        if len(middle) <= 12:
            axes.plot(middle[:, 0], middle[:, 1], color=colour, alpha=0.45, linewidth=0.8)
    return {str(label) for label in table["label"]}
