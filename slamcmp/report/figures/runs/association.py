"""What back ends do that gate for themselves: what they kept, how sure they were, how far off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from scipy.special import chdtri

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import (
    at_point,
    has_values,
    labels,
    middle_point,
    point_name,
    pose_dimension,
    swept_columns,
)
from slamcmp.results.store import Results

BINS = 40


@figures.register(
    "association",
    title="Association by each back end's own gate",
    needs=("trials: own_gate", "frames: gate_correct, gate_false_rejections (a truth that marks outliers)"),
    caption=(
        "Only back ends with a gate of their own: each chose observations from the same stream by its own "
        "covariance, so that they did not use the same ones. Top: share of the correct observations that "
        "passed, over neighbouring frames and all finished runs; first sightings count, which no gate can "
        "test, and a landmark that an outlier placed stays rejected in every back end. Middle and bottom: "
        "median over the runs, frame by frame. Right: each dot is a run, of every grid point. Dotted: the "
        "gate's probability, and what the NEES of a consistent back end would be."
    ),
)
def plot_association(results: Results) -> Figure:
    """Share of correct observations kept, NEES and error over time; share kept against NEES, run by run."""
    gated = gated_labels(results)
    if not gated:
        raise NotDrawable("no back end gates for itself (own_gate)")
    if not has_values(results.trials, ["gate_recall"]):
        raise NotDrawable("no run's correct observations are known: the log has no truth that marks outliers")
    point = middle_point(results)
    where = point_name(point)
    title = "What did each back end's own gate let through?" + (f"  {where}" if where else "")
    figure = style.new_figure(11.0, 7.2, title)
    grid = figure.add_gridspec(3, 2, width_ratios=[1.75, 1.0])
    share = figure.add_subplot(grid[0, 0])
    nees, error = (figure.add_subplot(grid[row, 0], sharex=share) for row in (1, 2))
    _draw_over_time(share, nees, error, results, gated)
    _draw_runs(figure.add_subplot(grid[:, 1]), results, gated)
    colours, markers = style.colours(results), style.markers(results)
    keys = []
    for label in gated:
        runs = _finished(results, label)["trial"].nunique()
        look = {"color": colours[label], "marker": markers[label], "markersize": 5}
        keys.append(style.line_key(f"{label} (N = {runs})", **look))
    style.legend_below(figure, keys)
    return figure


def gated_labels(results: Results) -> list[str]:
    """Labels of the back ends that gate for themselves at some grid point, in the table's order."""
    if not has_values(results.trials, ["own_gate"]):
        return []
    known = set(results.trials.loc[results.trials["own_gate"].notna(), "label"])
    return [label for label in labels(results) if label in known]


def share_kept(frames: pd.DataFrame) -> tuple[pd.Series[float], pd.Series[float]]:
    """Mid times [s] and share of the correct observations kept, of at most 40 groups of neighbouring frames.

    Sums over all runs and the frames of a group; NaN where nothing correct was there.
    """
    size = max(1, -(-(int(frames["k"].max()) + 1) // BINS))
    groups = frames.groupby(frames["k"] // size)
    correct = groups["gate_correct"].sum()
    lost = groups["gate_false_rejections"].sum()
    return groups["t"].mean(), 1.0 - lost / correct.where(correct > 0)


def _finished(results: Results, label: str) -> pd.DataFrame:
    """Frames of one back end's runs that are ok, at the middle grid point."""
    trials = at_point(results.trials, middle_point(results))
    ok = trials[(trials["status"] == "ok") & (trials["label"] == label) & trials["own_gate"].notna()]
    return results.frames[(results.frames["label"] == label) & results.frames["trial"].isin(ok["trial"])]


def _draw_over_time(share: Axes, nees: Axes, error: Axes, results: Results, gated: list[str]) -> None:
    colours, widths = style.colours(results), style.widths(results)
    for label in gated:
        frames = _finished(results, label)
        if frames.empty:
            continue
        look: dict[str, Any] = {"color": colours[label], "linewidth": widths[label]}
        share.plot(*share_kept(frames), **look)
        for axes, column in ((nees, "online_nees"), (error, "online_position_error_m")):
            values = frames[frames[column] > 0].groupby("t")[column].median()
            axes.plot(values.index, values, **look)
    for probability in sorted(set(results.trials["own_gate"].dropna())):
        share.axhline(probability, color="#444444", linewidth=0.8, linestyle=":", zorder=0.6)
    share.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    share.set_ylim(None, 1.02)
    share.set_title("Correct observations that passed")
    median = float(chdtri(_expected(results), 0.5))
    nees.axhline(median, color="#444444", linewidth=0.8, linestyle=":", zorder=0.6)
    style.log_axis(nees)
    nees.set_title(f"Online pose NEES, median of the runs: expected {median:.2f}")
    error.set_title("Online position error [m], median of the runs")
    error.set_xlabel("time [s]")
    for axes in (share, nees):
        axes.tick_params(labelbottom=False)


def _draw_runs(axes: Axes, results: Results, gated: list[str]) -> None:
    ok = results.trials[(results.trials["status"] == "ok") & results.trials["own_gate"].notna()]
    colours, markers = style.colours(results), style.markers(results)
    for label in gated:
        own = ok[ok["label"] == label]
        axes.plot(
            own["online_pose_nees"],
            own["gate_recall"],
            color=colours[label],
            marker=markers[label],
            markersize=5,
            alpha=0.75,
            linestyle="none",
        )
    style.log_if_wide(axes, ok["online_pose_nees"].to_numpy(dtype=np.float64), axis="x")
    axes.axvline(_expected(results), color="#444444", linewidth=0.8, linestyle=":", zorder=0.6)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_xlabel(f"mean online pose NEES of the run: expected {_expected(results)}")
    every = ", at every grid point" if swept_columns(results.trials) else ""
    axes.set_title(f"The same, run by run{every}")


def _expected(results: Results) -> int:
    return pose_dimension(results.frames)
