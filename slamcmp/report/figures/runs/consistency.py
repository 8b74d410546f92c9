"""NEES and NIS over time with the χ² bands that a consistent estimator stays in."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from slamcmp.metrics.consistency import average_band, chi2_band
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import at_point, has_values, labels, middle_point, point_name, pose_dimension
from slamcmp.results.store import Results

NIS_BINS = 80


NEES = (
    "NEES: squared pose error over the claimed covariance, averaged over the runs of one grid point, "
    "frame by frame (logarithmic). Above the band the back end is overconfident, below it too cautious."
)
NIS = (
    "NIS: squared innovations over what the back end expected, summed over neighbouring frames and divided "
    "by the degrees of freedom."
)
BANDS = (
    "The grey bands hold 95 % of a consistent estimator's values. A healthy NIS does not prove a healthy "
    "NEES. Runs that failed are left out and lower N."
)


def _caption(results: Results) -> str:
    """Of what is there: a log without truth has no NEES, smoothers have no NIS."""
    frames = results.frames
    has_nees = any(has_values(frames, [f"{which}_nees"]) for which in ("online", "final"))
    parts = [NEES] * has_nees + [NIS] * has_values(frames, ["nis", "nis_dof"])
    return " ".join([*parts, BANDS])


@figures.register(
    "consistency",
    title="Consistency",
    needs=("frames: online_nees or nis",),
    caption=f"{NEES} {NIS} {BANDS}",
    caption_of=_caption,
)
def plot_consistency(results: Results) -> Figure:
    """Average NEES (online, final) and binned NIS over time with 95 % χ² bands."""
    point = middle_point(results)
    ok = at_point(results.trials, point)
    ok = ok[ok["status"] == "ok"]
    frames = results.frames.merge(ok[["trial", "label"]], on=["trial", "label"])
    kinds = [which for which in ("online", "final") if has_values(frames, [f"{which}_nees"])]
    has_nis = has_values(frames, ["nis", "nis_dof"])
    if not kinds and not has_nis:
        raise NotDrawable("no run has a NEES (that needs the truth and covariances) or a NIS")
    rows = len(kinds) + has_nis
    where = point_name(point)
    title = "Is the claimed uncertainty right?" + (f"  {where}" if where else "")
    figure = style.new_figure(9.0, 2.5 * rows + 1.0, title)
    panels = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    shown: dict[str, int] = {}
    for which, axes in zip(kinds, panels, strict=False):
        shown |= _draw_nees(axes, results, frames, which)
    if has_nis:
        shown = _draw_nis(panels[-1], results, frames) | shown
    panels[-1].set_xlabel("time [s]")
    colours = style.colours(results)
    keys = [style.line_key(f"{label} (N = {runs})", color=colours[label]) for label, runs in shown.items()]
    style.legend_below(figure, [*keys, Patch(facecolor=style.BAND, alpha=0.5, label="95 % band")])
    return figure


def _draw_nees(axes: Axes, results: Results, frames: pd.DataFrame, which: str) -> dict[str, int]:
    column = f"{which}_nees"
    dof = pose_dimension(frames)
    shown = {}
    for label in labels(results):
        own = frames[(frames["label"] == label) & (frames[column] > 0)]
        if own.empty:
            continue
        mean = own.groupby("t")[column].mean()
        shown[label] = int(own["trial"].nunique())
        axes.plot(
            mean.index, mean, color=style.colours(results)[label], linewidth=style.widths(results)[label]
        )
    # The widest of the bands: with fewer runs an average strays further.
    runs = min(shown.values())
    low, high = average_band(dof, runs)
    axes.axhspan(low, high, color=style.BAND, alpha=0.5, linewidth=0, zorder=0.5)
    axes.axhline(dof, color="#444444", linewidth=0.7, zorder=0.6)
    style.log_axis(axes)
    axes.set_ylabel("pose NEES")
    average = "one run" if runs == 1 else f"mean of {runs} runs"
    axes.set_title(f"{which} pose NEES, {average}: expected {dof}, 95 % in [{low:.2f}, {high:.2f}]")
    return shown


def _draw_nis(axes: Axes, results: Results, frames: pd.DataFrame) -> dict[str, int]:
    shown = {}
    banded = False
    for label in labels(results):
        own = frames[(frames["label"] == label) & (frames["nis_dof"] > 0) & frames["nis"].notna()]
        if own.empty:
            continue
        time, ratio, dof = binned_nis(own)
        shown[label] = int(own["trial"].nunique())
        if not banded:
            low, high = chi2_band(dof)
            axes.fill_between(
                time, low / dof, high / dof, step="mid", color=style.BAND, alpha=0.5, linewidth=0, zorder=0.5
            )
            banded = True
        axes.plot(
            time,
            ratio,
            color=style.colours(results)[label],
            drawstyle="steps-mid",
            linewidth=style.widths(results)[label],
        )
    axes.axhline(1.0, color="#444444", linewidth=0.7, zorder=0.6)
    style.log_axis(axes)
    axes.set_ylabel("NIS / dof")
    axes.set_title("NIS per degree of freedom, summed over neighbouring frames and all runs: expected 1")
    return shown


def binned_nis(
    frames: pd.DataFrame,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mid times [s], NIS over dof, and dof of at most 80 groups of neighbouring frames.

    Innovations of a consistent filter are white, so their squares may be summed over time; NEES may not.
    """
    k = frames["k"].to_numpy()
    size = max(1, -(-(int(k.max()) + 1) // NIS_BINS))
    sums = (
        frames[["nis", "nis_dof", "t"]].groupby(k // size).agg({"nis": "sum", "nis_dof": "sum", "t": "mean"})
    )
    dof = sums["nis_dof"].to_numpy(dtype=float)
    return sums["t"].to_numpy(dtype=float), sums["nis"].to_numpy(dtype=float) / dof, dof
