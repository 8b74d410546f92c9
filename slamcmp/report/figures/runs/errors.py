"""Error over time against the ±3σ band that the back end claims."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable, typical_trial
from slamcmp.results.grid import has_values, labels, pose_dimension, reference_name, rows_of, trial_name
from slamcmp.results.store import Results

COMPONENTS = {
    3: (("forward [m]", 1.0), ("left [m]", 1.0), ("heading [deg]", 180.0 / np.pi)),
    6: tuple((f"rotation {axis} [deg]", 180.0 / np.pi) for axis in "xyz")
    + tuple((f"body {axis} [m]", 1.0) for axis in "xyz"),
}
BAND_POINTS = 800


CAPTION = (
    "Error of each pose in its own body axes (truth minus estimate) over the same trial as the map, "
    "with the ±3σ band that the back end claims. A consistent back end leaves its band in about one "
    "frame of 370. Every panel has its own vertical scale: judge the line by its band."
)


def _caption(results: Results) -> str:
    reference = reference_name(results)
    if reference in ("truth", "none"):
        return CAPTION
    return (
        f"Difference of each pose from that of {reference}, which stands in for the truth, in the pose's own "
        "body axes over the same trial as the map, with the ±3σ band that the back end claims. The "
        "reference has errors of its own: a line outside its band is a question, not a proof. Every panel "
        "has its own vertical scale."
    )


@figures.register(
    "errors",
    title="Errors over time",
    needs=("frames: online_err_*",),
    caption=CAPTION,
    caption_of=_caption,
)
def plot_errors(results: Results) -> Figure:
    """Pose errors with ±3σ of one typical trial: a column per back end, a row per component."""
    if not has_values(results.frames, ["online_err_0"]):
        raise NotDrawable("no run has errors: the log has no truth and no reference was named")
    trial = typical_trial(results)
    shown = [
        label
        for label in labels(results)
        if has_values(rows_of(results.frames, trial, label), ["online_err_0"])
    ]
    if not shown:
        raise NotDrawable(f"no run of {trial_name(results, trial)} has errors")
    p = pose_dimension(results.frames)
    reference = reference_name(results)
    noun = "Error" if reference == "truth" else f"Difference from {reference}"
    figure = style.new_figure(
        max(6.0, min(3.4 * len(shown) + 0.8, 13.0)),
        1.65 * p + 1.3,
        f"{noun} and the claimed ±3σ: {trial_name(results, trial)}",
    )
    grid = figure.subplots(p, len(shown), sharex=True, squeeze=False)
    colours = style.colours(results)
    for column, label in enumerate(shown):
        frames = rows_of(results.frames, trial, label)
        for row, (name, factor) in enumerate(COMPONENTS[p]):
            axes = grid[row, column]
            _draw_component(axes, frames, row, factor, colours[label])
            if column == 0:
                axes.set_ylabel(name)
        grid[0, column].set_title(label, color=colours[label], fontweight="bold")
        grid[-1, column].set_xlabel("time [s]")
    style.legend_below(
        figure,
        [
            style.line_key("online error", color="#777777", linewidth=1.0),
            Patch(facecolor="#CCCCCC", label="online ±3σ"),
            style.line_key("final error (darker)", color="#222222", linewidth=1.4),
            style.line_key("final ±3σ", color="#222222", linewidth=0.9, linestyle=":"),
        ],
    )
    return figure


def darker(colour: str) -> tuple[float, float, float]:
    """The back end's colour for what it knows with hindsight."""
    red, green, blue = to_rgb(colour)
    return 0.45 * red, 0.45 * green, 0.45 * blue


def _draw_component(axes: Axes, frames: pd.DataFrame, row: int, factor: float, colour: str) -> None:
    time = frames["t"].to_numpy(dtype=float)
    stride = max(1, len(time) // BAND_POINTS)
    online = factor * frames[f"online_err_{row}"].to_numpy(dtype=float)
    band = 3.0 * factor * frames[f"online_sigma_{row}"].to_numpy(dtype=float)
    axes.fill_between(
        time[::stride], -band[::stride], band[::stride], color=colour, alpha=0.22, linewidth=0, zorder=1
    )
    axes.plot(time, online, color=colour, linewidth=0.9, zorder=2)
    if has_values(frames, [f"final_err_{row}"]):
        dark = darker(colour)
        axes.plot(time, factor * frames[f"final_err_{row}"], color=dark, linewidth=1.2, zorder=3)
        if has_values(frames, [f"final_sigma_{row}"]):
            final_band = 3.0 * factor * frames[f"final_sigma_{row}"].to_numpy(dtype=float)
            for sign in (-1.0, 1.0):
                axes.plot(
                    time[::stride], sign * final_band[::stride], color=dark, linewidth=0.8, linestyle=":"
                )
    axes.axhline(0.0, color="#000000", linewidth=0.5, zorder=1.5)
