"""What the gap between filter and smoother is made of, run by run and as medians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from slamcmp.metrics.attribution import telescoped
from slamcmp.metrics.statistics import median_interval
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import at_point, middle_point, point_name
from slamcmp.results.numbers import interval_text
from slamcmp.results.store import Results


@dataclass(frozen=True)
class Stage:
    """One estimator on the way: where its score stands, and what it changed."""

    label: str
    column: str
    change: str
    """What this stage does and the last did not; empty for the first."""


@figures.register(
    "attribution",
    title="What the gap is made of",
    needs=(
        "trials: ekf_slam, iterated_ekf, sliding_window with window null and, of one length, latest and fej",
    ),
    caption=(
        "From the EKF's online error to full smoothing's final one, one change at a time on the same "
        "streams: iterating the update, keeping a window of poses, pinning first estimates, keeping all "
        "poses, and hindsight. Each part is the error it removes; below zero it adds error. The parts of "
        "a run sum to its whole gap. Right and below: median over the runs, from six runs on with the "
        "interval that covers the median of all possible runs with at least 95 %; medians need not sum. "
        "Runs where any stage failed are left out."
    ),
    table=lambda results: attribution_table(results),
)
def plot_attribution(results: Results) -> Figure:
    """Stacked parts of the gap for each run, and the median of each part with its interval."""
    stages, scores, runs = stage_scores(results)
    parts = telescoped(scores)
    where = point_name(middle_point(results))
    title = "What removes the filter's error?" + (f"  {where}" if where else "")
    figure = style.new_figure(11.0, 4.8, title)
    left, right = figure.subplots(1, 2, width_ratios=[1.6, 1.0])
    _draw_stacks(left, parts, runs)
    left.set_title("Run by run: parts sum to the gap (dots)")
    left.set_ylabel("position error removed, RMS [m]")
    left.set_xlabel("run, by size of its gap (seed)")
    _draw_medians(right, stages, parts)
    right.set_title("Median over runs, 95 % interval")
    right.set_xlabel("position error removed, RMS [m]")
    keys: list[Any] = [
        Patch(facecolor=colour, label=stage.change)
        for colour, stage in zip(style.PALETTE, stages[1:], strict=False)
    ]
    keys.append(style.line_key("whole gap", color="#222222", marker="o", linestyle="none", markersize=5))
    style.legend_below(figure, keys, columns=3)
    return figure


def attribution_table(results: Results) -> pd.DataFrame:
    """Median of each part and of the whole gap with 95 % intervals [m], and how many runs it helped.

    Raises:
        NotDrawable: a stage is missing, or no run finished every stage.
    """
    stages, scores, runs = stage_scores(results)
    rows = list(zip([stage.change for stage in stages[1:]], telescoped(scores).T, strict=True))
    rows.append(("whole gap", scores[:, 0] - scores[:, -1]))
    return pd.DataFrame(
        [
            {
                "part": name,
                "error removed, median [m]": (interval := median_interval(values)).estimate,
                "95 % of median [m]": interval_text(interval),
                "least [m]": float(values.min()),
                "most [m]": float(values.max()),
                "runs it helped": int((values > 0).sum()),
                "runs": len(runs),
            }
            for name, values in rows
        ]
    )


def stage_scores(results: Results) -> tuple[list[Stage], NDArray[np.float64], list[str]]:
    """Stages, scores (runs, stages) and the runs' names, runs in rising order of their gap.

    Raises:
        NotDrawable: a stage is missing, or no run finished every stage.
    """
    stages = find_stages(results.manifest)
    trials = at_point(results.trials, middle_point(results))
    trials = trials[trials["status"] == "ok"]
    columns = []
    for stage in stages:
        if stage.column not in trials:
            raise NotDrawable(f"no run has {stage.column}")
        own = trials[trials["label"] == stage.label]
        columns.append(own.set_index("trial")[stage.column])
    table = pd.concat(columns, axis=1).dropna()
    if table.empty:
        raise NotDrawable("no run finished every stage")
    scores = table.to_numpy(dtype=np.float64)
    order = np.argsort(scores[:, 0] - scores[:, -1], kind="stable")
    seeds = trials.drop_duplicates("trial").set_index("trial")["seed"]
    names = [str(seeds[trial]) for trial in table.index[order]]
    return stages, scores[order], names


def find_stages(manifest: Mapping[str, Any]) -> list[Stage]:
    """The chain from filter to smoother among an experiment's back ends.

    The window is the middle one of those run both with latest and with first estimates.

    Raises:
        NotDrawable: a link of the chain was not run; the message says which.
    """
    single: dict[str, str] = {}
    windows: dict[tuple[str, Any], str] = {}
    for entry in manifest.get("config", {}).get("back_ends", []):
        if entry["name"] == "sliding_window":
            windows[entry["linearisation"], entry["window"]] = entry["label"]
        else:
            single.setdefault(entry["name"], entry["label"])
    common = sorted(w for policy, w in windows if policy == "latest" and w and ("fej", w) in windows)
    common = [w for w in common if w > 1]
    full = windows.get(("latest", None))
    for name, there in (
        ("ekf_slam", "ekf_slam" in single),
        ("iterated_ekf", "iterated_ekf" in single),
        ("sliding_window of one length with latest and with fej", bool(common)),
        ("sliding_window with window null", full is not None),
    ):
        if not there:
            raise NotDrawable(f"{name} was not run")
    w = common[len(common) // 2]
    return [
        Stage(single["ekf_slam"], "online_ate", ""),
        Stage(single["iterated_ekf"], "online_ate", "iterate the update"),
        Stage(windows["latest", w], "online_ate", f"keep {w} poses"),
        Stage(windows["fej", w], "online_ate", "pin first estimates"),
        Stage(str(full), "online_ate", "keep all poses instead"),
        Stage(str(full), "final_ate", "hindsight"),
    ]


def _draw_stacks(axes: Axes, parts: NDArray[np.float64], runs: list[str]) -> None:
    x = np.arange(len(runs))
    above, below = np.zeros(len(runs)), np.zeros(len(runs))
    for values, colour in zip(parts.T, style.PALETTE, strict=False):
        base = np.where(values >= 0, above, below)
        axes.bar(x, values, bottom=base, color=colour, width=0.75)
        above += np.maximum(values, 0)
        below += np.minimum(values, 0)
    axes.plot(x, parts.sum(axis=1), linestyle="none", marker="o", color="#222222", markersize=5, zorder=4)
    axes.axhline(0, color="#444444", linewidth=0.8)
    axes.set_xticks(x, runs)
    axes.grid(axis="x", visible=False)


def _draw_medians(axes: Axes, stages: list[Stage], parts: NDArray[np.float64]) -> None:
    names = [stage.change for stage in stages[1:]]
    for row, (values, colour) in enumerate(zip(parts.T, style.PALETTE, strict=False)):
        interval = median_interval(values)
        axes.barh(row, interval.estimate, color=colour, height=0.6)
        axes.plot([interval.low, interval.high], [row, row], color="#222222", linewidth=1.6)
    axes.axvline(0, color="#444444", linewidth=0.8)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
