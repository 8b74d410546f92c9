"""How far each back end's belief is from the batch solution's at the same frame."""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.metrics.information import KL
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.runs.observability import look, median_series, ok_frames
from slamcmp.results.grid import has_values, labels
from slamcmp.results.store import Results

ZERO_NAT = 1e-6
"""Below it two solvers of the same cost differ by where they stopped."""
SMALLEST_NAT = 0.01
"""Where the axis ends: a seventh of a standard deviation in one direction."""


@figures.register(
    "kl_from_batch",
    title="Distance from the batch solution's belief",
    needs=("frames: kl_from_batch (experiments with record: {divergence_from: LABEL})",),
    caption=(
        "Kullback–Leibler divergence of each back end's belief about the current pose and the whole map "
        "(mean and joint covariance) from that of the batch solution of the same measurements, at the "
        "same frame; the pose in the body tangent, landmarks in world axes. 0: the same belief. 0.5 nat: "
        "as different as one standard deviation in one direction; a covariance that is too small counts "
        "as well. Both know the same measurements and nothing of the future: what is left is what it cost "
        "to marginalise with one linearisation. Left: median over the runs. Right: median over the "
        "frames, a dot a run, the bar their median."
    ),
)
def plot_kl_from_batch(results: Results) -> Figure:
    """Divergence over time, and each run's median."""
    frames, where = ok_frames(results)
    record = results.manifest.get("config", {}).get("record") or {}
    batch = record.get("divergence_from")
    if not has_values(frames, [KL]):
        raise NotDrawable(
            f"no run was compared: {batch!r} kept no posterior, see its status"
            if batch
            else "no run was compared: give the experiment record: {divergence_from: LABEL}"
        )
    told = frames[frames[KL].notna()]
    medians = told.groupby(["label", "trial"])[KL].median()
    by_label = medians.groupby("label").median()
    compared = [label for label in labels(results) if by_label.get(label, 0.0) > ZERO_NAT]
    if not compared:
        raise NotDrawable("every back end that was compared has the batch solution's belief")
    title = f"How far from the belief of {batch or 'batch'} at the same frame?"
    figure = style.new_figure(11.0, 4.9, title + (f"  {where}" if where else ""))
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    for label in compared:
        values = median_series(told, label, KL)
        left.plot(values.index, values.where(values > ZERO_NAT), linewidth=1.4, **look(results, label))
    style.log_axis(left)
    left.set_ylim(max(SMALLEST_NAT, left.get_ylim()[0]), None)
    left.set_xlabel("time [s]")
    left.set_ylabel("divergence [nat]")
    left.set_title("Over time, median over the runs")
    _draw_medians(right, results, medians, sorted(compared, key=lambda label: float(by_label[label])))
    style.legend_below(
        figure, [style.line_key(label, **look(results, label)) for label in compared], columns=5
    )
    return figure


def _draw_medians(axes: Axes, results: Results, medians: pd.Series[Any], names: list[str]) -> None:
    for row, label in enumerate(names):
        own = medians[label]
        colour = style.colours(results)[label]
        axes.plot(own, [row] * len(own), linestyle="none", marker="o", markersize=4, alpha=0.5, color=colour)
        axes.plot([own.median()] * 2, [row - 0.3, row + 0.3], color=colour, linewidth=2.5)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    style.log_axis(axes, "x")
    axes.set_xlabel("divergence [nat]")
    axes.set_title("Over the frames, best on top")
