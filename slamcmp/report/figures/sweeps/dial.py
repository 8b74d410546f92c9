"""The dial from filter to smoother: accuracy, consistency and cost over the window, by linearisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from slamcmp.metrics.consistency import average_band
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import (
    at_point,
    has_values,
    middle_point,
    milliseconds_per_frame,
    point_name,
    pose_dimension,
)
from slamcmp.results.store import IMPORTED, Results

POLICIES = {
    "latest": "latest estimate",
    "fej": "first estimates (FEJ)",
    "frozen": "frozen: never relinearised",
}
ENDS = {
    "ekf_slam": ("EKF", "*"),
    "iterated_ekf": ("iterated EKF", "D"),
    "ekf_oc": ("OC-EKF", "P"),
    "ekf_right_invariant": ("right-invariant EKF", "X"),
    "ekf_ideal": ("ideal EKF: at the truth", "v"),
}
"""Filters of one pose: name and marker. Those that linearise elsewhere stand a little to the left."""
SOLID = ("*", "p")
ASIDE = {"P": -0.3, "X": -0.3, "v": -0.3}
FULL = ("full smoothing", "p")
INFINITE = "∞"
NEAR = 0.1
"""Share of full smoothing's error that counts as having arrived."""


@dataclass(frozen=True)
class Curve:
    """One linearisation policy: windows in rising order and the labels of their runs."""

    policy: str
    windows: tuple[int, ...]
    labels: tuple[str, ...]


@figures.register(
    "dial",
    title="From filter to smoother",
    needs=("trials: sliding_window, or imported runs with a parameter window, with at least two windows",),
    caption=(
        "Each point is one estimator on the same seeds: to the right it keeps more poses before it "
        "marginalises them. Error: median over the runs, with its quartiles as bars. NEES: mean over runs "
        "and frames; the grey band holds 95 % of a consistent estimator's averages over that many runs at "
        "one instant, so a point above it is overconfident for certain. Time: updates and estimates of the "
        "online answer. Dotted lines lead to full smoothing, which marginalises nothing and so is the end of "
        "every policy that relinearises. Hollow marks are filters of one pose. Failed runs are counted at "
        "their point and are in no number."
    ),
)
def plot_dial(results: Results) -> Figure:
    """Online position error, pose NEES and time per frame over the window, one curve a policy."""
    point = middle_point(results)
    trials = at_point(results.trials, point)
    trials = trials.assign(online_ms=milliseconds_per_frame(trials, "update_s", "estimate_s"))
    curves, ends, full = arrangement(results.manifest)
    present = set(trials["label"])
    if sum(len(set(curve.labels) & present) for curve in curves) < 2:
        raise NotDrawable("no sliding_window was run with two windows, nor are any imported")
    windows = sorted({window for curve in curves for window in curve.windows})
    places = {window: float(i) for i, window in enumerate(windows)}
    right = float(len(windows))
    where = point_name(point)
    title = "One dial from filter to smoother" + (f"  {where}" if where else "")
    if full in present:
        title += reach(trials, curves, str(full))
    # Mean for the panel with the band, which is one of means.
    content = [
        ("online_ate", "median", "Error: what more poses buy", "online position error, RMS [m]"),
        ("online_pose_nees", "mean", "Honesty: is the claimed covariance right?", "mean online pose NEES"),
        ("online_ms", "median", "Price: time per frame", "time [ms per frame]"),
    ]
    if (trials["back_end"] == IMPORTED).any():
        # Another system's world is its own, and of its time and often of its covariance nothing is known.
        which = "online" if has_values(trials, ["online_ate_aligned"]) else "final"
        unit = f"{which} position error, aligned, RMS [m]"
        content[0] = (f"{which}_ate_aligned", "median", "Error: what more poses buy", unit)
        content = [each for each in content if has_values(trials, [each[0]])]
    figure = style.new_figure(4.0 * max(len(content), 1.5), 4.6, title)
    panels = list(np.atleast_1d(figure.subplots(1, len(content))))
    for axes, (column, statistic, title, unit) in zip(panels, content, strict=True):
        if not has_values(trials, [column]):
            raise NotDrawable(f"no run has {column.replace('_', ' ')}")
        if column == "online_pose_nees":
            _draw_band(axes, results, trials, right)
        for row, curve in enumerate(curves):
            colour, marker = style.PALETTE[row], style.MARKERS[row]
            # Side by side, so that the quartiles of one policy do not hide another's.
            dodge = 0.1 * (row - (len(curves) - 1) / 2) if column == content[0][0] else 0.0
            _draw_curve(axes, trials, curve, column, statistic, places, colour, marker, dodge)
            if full in present and curve.policy != "frozen":
                _draw_lead(axes, trials, curve, str(full), column, statistic, places, right, colour)
        for label, (_, marker) in ends.items():
            if label in present:
                _draw_end(axes, trials, label, column, statistic, ASIDE.get(marker, 0.0), marker)
        if full in present:
            _draw_end(axes, trials, str(full), column, statistic, right, FULL[1])
        axes.set_title(title)
        axes.set_ylabel(unit)
        axes.set_xlabel("← filter      window: poses kept      smoother →")
        # Imported windows have no full smoothing beside them.
        end = full is not None or content[0][0] == "online_ate"
        axes.set_xlim(-0.5, right + 0.4 - (not end))
        ticks = {
            **{str(window): place for window, place in places.items()},
            **({INFINITE: right} if end else {}),
        }
        axes.set_xticks(list(ticks.values()), list(ticks))
        style.log_axis(axes)
    _count_failures(panels[0], trials, curves, places)
    band = any(column == "online_pose_nees" for column, *_ in content)
    style.legend_below(figure, _keys(curves, ends, full=full in present, band=band), columns=4)
    return figure


def arrangement(
    manifest: Mapping[str, Any],
) -> tuple[list[Curve], dict[str, tuple[str, str]], str | None]:
    """Curves, marked filters (label to name and marker) and the label of full smoothing, from a manifest."""
    groups: dict[str, dict[int, str]] = {}
    ends: dict[str, tuple[str, str]] = {}
    full = None
    for entry in manifest.get("config", {}).get("back_ends", []):
        name, label = entry["name"], entry["label"]
        if name in ENDS:
            ends[label] = ENDS[name]
        elif name == "sliding_window" and entry["window"] is not None:
            groups.setdefault(entry["linearisation"], {})[int(entry["window"])] = label
        elif name == "sliding_window" and entry["linearisation"] != "frozen":
            full = label
        elif name == IMPORTED and isinstance(entry.get("window"), int):
            groups.setdefault(str(entry.get("family", IMPORTED)), {})[entry["window"]] = label
    curves = []
    for policy in (*(each for each in POLICIES if each in groups), *(g for g in groups if g not in POLICIES)):
        windows = tuple(sorted(groups[policy]))
        curves.append(Curve(policy, windows, tuple(groups[policy][window] for window in windows)))
    return curves, ends, full


def reach(trials: pd.DataFrame, curves: list[Curve], full: str) -> str:
    """``: error within 10% of full smoothing from w = 20 (latest), …``, for policies that get and stay there.

    Said of medians over the runs; empty where no policy does.
    """
    goal = (1.0 + NEAR) * finished(trials, full, "online_ate").median()
    said = []
    for curve in curves:
        near = [finished(trials, label, "online_ate").median() <= goal for label in curve.labels]
        there = [window for i, window in enumerate(curve.windows) if all(near[i:])]
        if there:
            said.append(f"w = {there[0]} ({curve.policy.replace('fej', 'FEJ')})")
    return f": error within {NEAR:.0%} of full smoothing from {', '.join(said)}" if said else ""


def finished(trials: pd.DataFrame, label: str, column: str) -> pd.Series[float]:
    """A metric's values over the runs of one label that ended well."""
    values: pd.Series[float] = trials.loc[(trials["label"] == label) & (trials["status"] == "ok"), column]
    return values.dropna()


def _draw_curve(
    axes: Axes,
    trials: pd.DataFrame,
    curve: Curve,
    column: str,
    statistic: str,
    places: Mapping[int, float],
    colour: str,
    marker: str,
    dodge: float,
) -> None:
    x, middle, low, high = [], [], [], []
    for window, label in zip(curve.windows, curve.labels, strict=True):
        values = finished(trials, label, column)
        if values.empty:
            continue
        x.append(places[window] + dodge)
        middle.append(float(values.agg(statistic)))
        low.append(float(values.quantile(0.25)))
        high.append(float(values.quantile(0.75)))
    axes.plot(x, middle, color=colour, marker=marker, markersize=5, zorder=3)
    if dodge or column.endswith(("_ate", "_ate_aligned")):
        axes.vlines(x, low, high, color=colour, alpha=0.55, linewidth=1.6, zorder=2)


def _draw_lead(
    axes: Axes,
    trials: pd.DataFrame,
    curve: Curve,
    full: str,
    column: str,
    statistic: str,
    places: Mapping[int, float],
    right: float,
    colour: str,
) -> None:
    """The dotted way from the longest window to full smoothing."""
    last, end = finished(trials, curve.labels[-1], column), finished(trials, full, column)
    if not last.empty and not end.empty:
        heights = [float(last.agg(statistic)), float(end.agg(statistic))]
        axes.plot([places[curve.windows[-1]], right], heights, color=colour, linestyle=":", zorder=2.5)


def _draw_end(
    axes: Axes, trials: pd.DataFrame, label: str, column: str, statistic: str, x: float, marker: str
) -> None:
    values = finished(trials, label, column)
    if not values.empty:
        axes.plot(
            [x],
            [float(values.agg(statistic))],
            linestyle="none",
            marker=marker,
            markersize=11 if marker in SOLID else 7,
            markerfacecolor="#222222" if marker in SOLID else "none",
            markeredgecolor="#222222",
            zorder=4,
        )


def _draw_band(axes: Axes, results: Results, trials: pd.DataFrame, right: float) -> None:
    dof = pose_dimension(results.frames)
    runs = int(trials["trial"].nunique())
    low, high = average_band(dof, runs)
    axes.axhspan(low, high, color=style.BAND, alpha=0.5, linewidth=0, zorder=0.5)
    axes.axhline(dof, color="#444444", linewidth=0.7, zorder=0.6)
    for text, height, side in (
        (f"95 % of {runs}-run means: consistent", low, "top"),
        ("↑ overconfident", high, "bottom"),
    ):
        axes.annotate(
            text,
            (right + 0.3, height),
            xytext=(0, -3 if side == "top" else 3),
            textcoords="offset points",
            ha="right",
            va=side,
            fontsize=8,
            color="#444444",
        )
    axes.margins(y=0.12)


def _count_failures(
    axes: Axes, trials: pd.DataFrame, curves: list[Curve], places: Mapping[int, float]
) -> None:
    for row, (curve, colour) in enumerate(zip(curves, style.PALETTE, strict=False)):
        for window, label in zip(curve.windows, curve.labels, strict=True):
            failed = int(((trials["label"] == label) & (trials["status"] != "ok")).sum())
            if failed:
                axes.annotate(
                    f"{failed} failed",
                    (places[window], 0.99 - 0.05 * row),
                    xycoords=("data", "axes fraction"),
                    color=colour,
                    fontsize=7.5,
                    ha="center",
                    va="top",
                )


def _keys(curves: list[Curve], ends: Mapping[str, tuple[str, str]], *, full: bool, band: bool) -> list[Any]:
    keys: list[Any] = [
        style.line_key(POLICIES.get(curve.policy, curve.policy), color=colour, marker=marker)
        for curve, colour, marker in zip(curves, style.PALETTE, style.MARKERS, strict=False)
    ]
    marks = [*ends.values(), *([FULL] if full else [])]
    keys += [
        style.line_key(
            name,
            color="#222222",
            marker=marker,
            linestyle="none",
            markersize=9 if marker in SOLID else 6,
            markerfacecolor="#222222" if marker in SOLID else "none",
        )
        for name, marker in marks
    ]
    return [*keys, Patch(facecolor=style.BAND, alpha=0.5, label="95 % band")] if band else keys
