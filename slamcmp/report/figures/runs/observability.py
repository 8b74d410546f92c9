"""What back ends know that no sensor can see: nullity, spurious information, drift of the Jacobians."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.metrics.information import KL
from slamcmp.metrics.observability import NULLITY, SHIFT, TURN
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import at_point, has_values, labels, middle_point, point_name, pose_dimension
from slamcmp.results.store import Results

DRIFT = "drift_landmarks_m"
DODGE = 0.05
"""Between the lines of back ends with the same nullity."""
COMPASSES_DEG = (30.0, 10.0, 6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 0.7, 0.5, 0.3, 0.2, 0.1)
SMALLEST_DRIFT_M = 1e-3
ROUNDING = 1e-6
"""Information [1/rad²] below which nothing is known: a compass of a thousand turns."""


@figures.register(
    "observability",
    title="What no sensor can see",
    needs=("frames: nullity, spurious_turn_per_rad2 (experiments with record: {observability: true})",),
    caption=(
        "Nothing a robot measures tells where in the world its map lies, or how it is turned. Each back "
        "end's own linear system is asked what it would know about the pose had it known nothing at the "
        "start. Top: directions that stay unknown; 3 in the plane (6 in space) is right, and the standard "
        "EKF has lost one, the heading. Middle: how much it believes to know of the heading; 0 is right, "
        "and the scale on the right reads it as a compass that nobody installed. Bottom: how far from the "
        "estimate the Jacobians of the frame's observations were taken; pinned points keep the top right "
        "at this price. Medians over the runs that are ok, at the frames that were looked at; where none "
        "of them sees a known landmark there is no distance."
    ),
    table=lambda results: observability_table(results),
)
def plot_observability(results: Results) -> Figure:
    """Nullity, spurious information on the heading and drift of the Jacobians' points over time."""
    frames, where = ok_frames(results)
    if not has_values(frames, [NULLITY]):
        raise NotDrawable("no run recorded it: give the experiment record: {observability: true}")
    rows = 3 if has_values(frames, [DRIFT]) else 2
    title = "What does it know that no sensor can see?" + (f"  {where}" if where else "")
    figure = style.new_figure(10.0, 2.6 * rows + 1.5, title)
    panels = figure.subplots(rows, 1, sharex=True)
    _draw_nullity(panels[0], results, frames)
    _draw_information(panels[1], results, frames)
    if rows == 3:
        _draw_drift(panels[2], results, frames)
    panels[-1].set_xlabel("time [s]")
    shown = [label for label in labels(results) if has_values(frames[frames["label"] == label], [NULLITY])]
    style.legend_below(figure, [style.line_key(label, **look(results, label)) for label in shown], columns=4)
    return figure


def observability_table(results: Results) -> pd.DataFrame:
    """One row per back end that told: medians over its runs that are ok at the middle grid point."""
    trials = at_point(results.trials, middle_point(results))
    trials = trials[trials["status"] == "ok"]
    rows = []
    for label in labels(results):
        own = trials[trials["label"] == label]
        if not has_values(own, [NULLITY]):
            continue
        found, turn = sorted(own[NULLITY].dropna().astype(int).unique()), float(own[TURN].dropna().median())
        rows.append(
            {
                "back end": label,
                "nullity at the end": " or ".join(str(value) for value in found),
                "spurious information on turns [1/rad²]": turn,
                "as a compass of σ [deg]": math.degrees(turn**-0.5) if turn > ROUNDING else math.nan,
                "on shifts [1/m²]": float(own[SHIFT].dropna().median()),
                "Jacobian drift [m]": float(own["linearisation_drift"].dropna().median()),
                **(
                    {"KL from batch [nat]": float(own[f"{KL}_median"].dropna().median())} if KL in own else {}
                ),
                "online pose NEES": float(own["online_pose_nees"].dropna().median()),
                "runs": len(own),
            }
        )
    return pd.DataFrame(rows)


def ok_frames(results: Results) -> tuple[pd.DataFrame, str]:
    """The frames of the runs that are ok at the middle grid point, and the point's name."""
    point = middle_point(results)
    ok = at_point(results.trials, point)
    ok = ok[ok["status"] == "ok"]
    return results.frames.merge(ok[["trial", "label"]], on=["trial", "label"]), point_name(point)


def median_series(frames: pd.DataFrame, label: str, column: str) -> pd.Series[Any]:
    """Median over the runs of a back end by time stamp, where any run has a value."""
    own = frames[(frames["label"] == label) & frames[column].notna()]
    return own.groupby("t")[column].median()


def look(results: Results, label: str) -> dict[str, Any]:
    """Colour and dashes of a back end: more than seven share the colours."""
    dashed = labels(results).index(label) >= len(style.PALETTE)
    return {"color": style.colours(results)[label], "linestyle": "--" if dashed else "-"}


def _draw_nullity(axes: Axes, results: Results, frames: pd.DataFrame) -> None:
    right = pose_dimension(frames)
    series = {label: median_series(frames, label, NULLITY) for label in labels(results)}
    ends: dict[float, list[str]] = {}
    for label, values in series.items():
        if len(values):
            ends.setdefault(float(values.iloc[-1]), []).append(label)
    for end, names in ends.items():
        for rank, label in enumerate(names):
            beside = DODGE * ((len(names) - 1) / 2 - rank)
            axes.plot(series[label].index, series[label] + beside, linewidth=1.4, **look(results, label))
        _note(axes, end - 0.5 * DODGE * len(names), f"{end:g}: {', '.join(names)}")
    axes.axhline(right, color="#444444", linewidth=0.7, zorder=0.6)
    axes.set_ylim(-0.75, right + 0.5)
    axes.set_yticks(range(right + 1))
    axes.set_ylabel("nullity")
    axes.set_title(
        f"Directions that stay unobservable; {right} is right (equal lines are drawn side by side)"
    )


def _draw_information(axes: Axes, results: Results, frames: pd.DataFrame) -> None:
    highest, nothing = 1.0, []
    for label in labels(results):
        values = median_series(frames, label, TURN)
        if len(values):
            highest = max(highest, float(values.max()))
            axes.plot(values.index, values, linewidth=1.4, **look(results, label))
            nothing += [label] if values.max() < ROUNDING else []
    axes.set_ylim(-0.16 * highest, 1.08 * highest)
    if nothing:
        _note(axes, 0.0, f"0: {', '.join(nothing)}")
    axes.set_ylabel("information [1/rad²]")
    axes.set_title("What it believes to know of the heading, had it started without one (0 is right)")
    compass = axes.twinx()
    compass.set_ylim(axes.get_ylim())
    shown = [(degrees, math.degrees(1.0) ** 2 / degrees**2) for degrees in COMPASSES_DEG]
    apart = 0.07 * axes.get_ylim()[1]
    ticks: list[tuple[float, float]] = []
    for degrees, value in shown:
        if value <= axes.get_ylim()[1] and (not ticks or value - ticks[-1][1] > apart) and value > apart:
            ticks.append((degrees, value))
    compass.set_yticks([value for _, value in ticks], [f"{degrees:g}°" for degrees, _ in ticks])
    compass.grid(visible=False)
    compass.set_ylabel("as a compass of σ")


def _draw_drift(axes: Axes, results: Results, frames: pd.DataFrame) -> None:
    for label in labels(results):
        values = median_series(frames, label, DRIFT)
        values = values.where(values >= SMALLEST_DRIFT_M, SMALLEST_DRIFT_M)
        axes.plot(values.index, values, linewidth=1.4, **look(results, label))
    style.log_axis(axes)
    axes.set_ylim(0.8 * SMALLEST_DRIFT_M, None)
    axes.set_ylabel("distance [m]")
    axes.set_title(
        "From where the Jacobians were taken to where the landmarks are now estimated "
        f"(shortest shown: {SMALLEST_DRIFT_M:g} m)"
    )


def _note(axes: Axes, height: float, text: str) -> None:
    """Small text under a line, at the right end."""
    axes.annotate(
        text,
        (1.0, height),
        xycoords=("axes fraction", "data"),
        xytext=(-4, -3),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=8,
        color="#444444",
    )
