"""Where the robot drove and where the landmarks stand, as each back end believes, beside the truth."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from scipy.special import chdtri

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.results.grid import has_values, labels, reference_name, rows_of, trial_name
from slamcmp.results.store import Results

POSE_ELLIPSES = 12
"""Pose covariances drawn along the online trajectory."""
CHI2_95 = float(chdtri(2, 0.05))
CROWD = 200
"""Landmarks, from which on their ellipses are drawn faint: a camera's long ones hide all else."""


LINES = (
    "Dashed: online, what the robot knew when it was there; solid: final, with hindsight. Ellipses hold the "
    "position with 95 % if the covariance is right (to scale). Estimates far outside the reference are cut "
    "off."
)


def _caption(results: Results) -> str:
    if results.trials["trial"].nunique() == 1:
        return f"Trajectories and landmarks. {LINES}"
    trial = trial_name(results, typical_trial(results))
    return (
        f"Trajectories and landmarks of one typical trial, {trial}: its online error is the median. {LINES}"
    )


@figures.register(
    "map",
    title="Map",
    needs=("frames: online_x, online_y",),
    caption=f"Trajectories and landmarks of one typical trial (median online error). {LINES}",
    caption_of=_caption,
)
def plot_map(results: Results) -> Figure:
    """Trajectories, landmarks and 95 % ellipses of one typical trial, a panel per back end."""
    if not has_values(results.frames, ["online_x", "online_y"]):
        raise NotDrawable("no run has a trajectory")
    trial = typical_trial(results)
    shown = [label for label in labels(results) if not rows_of(results.frames, trial, label).empty]
    first = rows_of(results.frames, trial, shown[0])
    limits = _limits(results, trial, shown)
    columns = 2 if len(shown) == 4 else min(3, len(shown))
    rows = math.ceil(len(shown) / columns)
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    panel = 10.0 / columns
    title = f"Map: {trial_name(results, trial)}"
    figure = style.new_figure(10.0, rows * (min(max(panel * aspect, 2.2), 6.5) + 0.7) + 0.9, title)
    grid = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)).ravel()
    colours = style.colours(results)
    reference = reference_name(results)
    for axes, label in zip(grid, shown, strict=False):
        _draw_run(axes, results, trial, label, colours[label])
        axes.set_title(_panel_title(results, trial, label), color=colours[label], fontweight="bold")
        axes.set(aspect="equal", xlim=limits[:2], ylim=limits[2:])
        axes.label_outer()
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    for index, axes in enumerate(grid[: len(shown)]):
        if index + columns >= len(shown):
            axes.set_xlabel("x [m]")
            axes.xaxis.set_tick_params(labelbottom=True)
        if index % columns == 0:
            axes.set_ylabel("y [m]")
    grey = "#555555"
    keys = [
        style.line_key("online", color=grey, linestyle="--"),
        style.line_key("final", color=grey),
        style.line_key("landmark, estimated", color=grey, linestyle="", marker="o", markersize=4),
        style.line_key("95 % ellipse", color=grey, linestyle="", marker="o", mfc="none", markersize=9),
    ]
    if has_values(first, ["true_x"]):
        keys.insert(0, style.line_key(reference, color=style.TRUTH, linewidth=0.9))
    if has_values(results.landmarks, ["true_x"]):
        keys.append(
            style.line_key(
                f"landmark, {reference}", color=style.TRUTH, linestyle="", marker="+", markersize=6
            )
        )
    style.legend_below(figure, keys)
    return figure


def ellipse_95(x: float, y: float, P_xx: float, P_xy: float, P_yy: float, **options: object) -> Ellipse:
    """The ellipse that holds a normal variable with 95 %: semi-axes sqrt(5.991 · eigenvalues of P)."""
    values, vectors = np.linalg.eigh(np.array([[P_xx, P_xy], [P_xy, P_yy]]))
    width, height = 2.0 * np.sqrt(CHI2_95 * np.clip(values, 0.0, None))
    angle = math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    return Ellipse((x, y), float(width), float(height), angle=angle, **options)


def _draw_run(axes: Axes, results: Results, trial: int, label: str, colour: str) -> None:
    frames = rows_of(results.frames, trial, label)
    landmarks = rows_of(results.landmarks, trial, label)
    if has_values(frames, ["true_x"]):
        axes.plot(frames["true_x"], frames["true_y"], color=style.TRUTH, linewidth=0.9, zorder=2)
    axes.plot(frames["online_x"], frames["online_y"], color=colour, linestyle="--", linewidth=1.1, zorder=3)
    if has_values(frames, ["final_x"]):
        axes.plot(frames["final_x"], frames["final_y"], color=colour, linewidth=1.3, zorder=2.5)
    if not landmarks.empty:
        if has_values(landmarks, ["true_x"]):
            axes.plot(
                landmarks["true_x"],
                landmarks["true_y"],
                "+",
                color=style.TRUTH,
                markersize=5,
                mew=0.8,
                zorder=5,
            )
        axes.plot(landmarks["x"], landmarks["y"], "o", color=colour, markersize=2.5, zorder=4)
    poses = frames.iloc[np.linspace(0, len(frames) - 1, min(POSE_ELLIPSES, len(frames))).astype(int)]
    renamed = poses.rename(columns={f"online_{name}": name for name in ("x", "y", "P_xx", "P_xy", "P_yy")})
    _draw_ellipses(axes, renamed, colour)
    _draw_ellipses(axes, landmarks, colour, alpha=0.2 if len(landmarks) >= CROWD else 1.0)


def _draw_ellipses(axes: Axes, table: pd.DataFrame, colour: str, alpha: float = 1.0) -> None:
    names = ["x", "y", "P_xx", "P_xy", "P_yy"]
    if table.empty or not has_values(table, names):
        return
    for x, y, P_xx, P_xy, P_yy in table[names].dropna().to_numpy(dtype=float):
        axes.add_patch(
            ellipse_95(
                x, y, P_xx, P_xy, P_yy, fill=False, edgecolor=colour, alpha=alpha, linewidth=0.7, zorder=3
            )
        )


def _limits(results: Results, trial: int, shown: list[str]) -> NDArray[np.float64]:
    """x and y limits: the reference with some room, or the median back end's extent without one."""
    boxes = []
    for label in shown:
        frames = rows_of(results.frames, trial, label)
        landmarks = rows_of(results.landmarks, trial, label)
        prefix = "true_" if has_values(frames, ["true_x"]) else "online_"
        points = [frames[[f"{prefix}x", f"{prefix}y"]].to_numpy(dtype=float)]
        if not landmarks.empty:
            names = ["true_x", "true_y"] if has_values(landmarks, ["true_x"]) else ["x", "y"]
            points.append(landmarks[names].to_numpy(dtype=float))
        stacked = np.concatenate(points)
        stacked = stacked[np.isfinite(stacked).all(axis=1)]
        if len(stacked):
            boxes.append([*stacked.min(axis=0), *stacked.max(axis=0)])
    if not boxes:
        raise NotDrawable("no run has a finite position")
    box = np.median(np.array(boxes), axis=0)
    room = 0.12 * max(box[2] - box[0], box[3] - box[1], 1.0)
    return np.array([box[0] - room, box[2] + room, box[1] - room, box[3] + room])


def _panel_title(results: Results, trial: int, label: str) -> str:
    row = rows_of(results.trials, trial, label).iloc[0]
    parts = [
        f"{which} ATE {row[f'{which}_ate']:.3g} m"
        for which in ("online", "final")
        if f"{which}_ate" in row and pd.notna(row[f"{which}_ate"])
    ]
    if len(parts) == 1 and parts[0].startswith("online"):
        parts.append("no final trajectory")
    if row["status"] != "ok":
        parts.append(str(row["status"]))
    return "\n".join([label, *parts])
