"""How error, consistency and cost change with what the experiment swept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.metrics.statistics import median_interval
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.grid import (
    at_point,
    has_values,
    labels,
    middle_point,
    milliseconds_per_frame,
    point_name,
    pose_dimension,
    swept_columns,
    value_text,
)
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words

PANELS = (
    ("ate", "ATE [m]"),
    ("heading_rmse_deg", "heading RMSE [deg]"),
    ("pose_nees", "pose NEES (dotted: expected)"),
    ("ms", "time [ms per frame]"),
)

MULTIPLES_MAX = 5
"""Values of the second swept path that columns of panels have room for."""
DODGE = 0.012
"""Share of the axis between two back ends at one swept value: equal results must not hide one another."""


@figures.register(
    "sweep",
    title="Sweep",
    needs=("trials: at least one swept path with two values",),
    caption=(
        "Median over the finished runs of each grid point (of two swept parameters, a column for each value "
        "of one); thin bars: quartiles of the runs, thick pale ones "
        "(from six runs on): 95 % interval of the median. Dashed: online "
        "(causal); solid: final (hindsight). Time: updates and estimates of the online answer. Numbers at "
        "the top of the first panel count failed runs, which are in no median."
    ),
)
def plot_sweep(results: Results) -> Figure:
    """Median and quartiles of the main metrics against each swept path, per back end."""
    trials = results.trials.assign(online_ms=milliseconds_per_frame(results.trials, "update_s", "estimate_s"))
    paths = [path for path in swept_columns(trials) if trials[path].nunique(dropna=False) > 1]
    if not paths:
        raise NotDrawable("nothing was swept")
    panels = [
        (metric, name)
        for metric, name in PANELS
        if has_values(trials, [f"online_{metric}"]) or has_values(trials, [f"final_{metric}"])
    ]
    if not panels:
        raise NotDrawable("no run has an error, a NEES or a time to draw against what was swept")
    figure = _small_multiples(results, trials, paths, panels) or _row_per_path(results, trials, paths, panels)
    colours, markers = style.colours(results), style.markers(results)
    keys = [style.line_key(label, color=colours[label], marker=markers[label]) for label in labels(results)]
    if has_values(trials, ["final_ate"]):
        keys += [
            style.line_key(which, color="#555555", linestyle=line) for which, line in style.LINES.items()
        ]
    style.legend_below(figure, keys)
    return figure


def _row_per_path(
    results: Results, trials: pd.DataFrame, paths: list[str], panels: list[tuple[str, str]]
) -> Figure:
    """A row of panels for each path, the others in the middle of their values."""
    middle, words = middle_point(results), parameters_in_words(paths)
    title = f"Against {' and '.join(words.values())}"
    figure = style.new_figure(2.9 * len(panels) + 0.6, 2.9 * len(paths) + 1.1, title)
    grid = figure.subplots(len(paths), len(panels), squeeze=False)
    for row, path in enumerate(paths):
        others = {other: value for other, value in middle.items() if other != path}
        rows = _with_names(at_point(trials, others), path)
        for column, (metric, name) in enumerate(panels):
            axes = grid[row, column]
            _draw_metric(axes, results, rows, path, metric)
            axes.set_title(name)
            axes.set_xlabel(words[path])
        _count_failures(grid[row, 0], results, rows, path)
        if others:
            grid[row, 0].set_ylabel(point_name(others))
    return figure


def _small_multiples(
    results: Results, trials: pd.DataFrame, paths: list[str], panels: list[tuple[str, str]]
) -> Figure | None:
    """Of two paths: a column for each value of the one with fewer, along the other one; a row a metric."""
    if len(paths) != 2:
        return None
    counts = {path: trials[path].nunique(dropna=False) for path in paths}
    across, along = sorted(paths, key=lambda path: counts[path])
    if counts[across] > MULTIPLES_MAX:
        return None
    words = parameters_in_words(paths)
    values = list(trials[across].drop_duplicates())
    title = f"Against {words[along]}, for each {words[across]}"
    figure = style.new_figure(2.9 * len(values) + 0.6, 2.4 * len(panels) + 1.1, title)
    grid = figure.subplots(len(panels), len(values), squeeze=False, sharey="row")
    for column, value in enumerate(values):
        rows = _with_names(at_point(trials, {across: value}), along)
        for row, (metric, name) in enumerate(panels):
            axes = grid[row, column]
            _draw_metric(axes, results, rows, along, metric)
            if row == 0:
                axes.set_title(point_name({across: value}))
            if row == len(panels) - 1:
                axes.set_xlabel(words[along])
            if column == 0:
                axes.set_ylabel(name)
        _count_failures(grid[0, column], results, rows, along)
    return figure


def quartiles_by(rows: pd.DataFrame, path: str, column: str) -> pd.DataFrame:
    """Quartiles (columns 0.25, 0.5, 0.75) of a metric over the finished runs at each swept value."""
    ok = rows[(rows["status"] == "ok") & rows[column].notna()]
    return ok.groupby(path, sort=False)[column].quantile(np.array([0.25, 0.5, 0.75])).unstack()


def median_bounds(
    rows: pd.DataFrame, path: str, column: str, values: Sequence[Any]
) -> tuple[list[float], list[float]]:
    """Bounds of each median's 95 % interval over the finished runs; NaN below six runs."""
    ok = rows[rows["status"] == "ok"]
    found = [median_interval(ok[ok[path] == value][column].astype(float)) for value in values]
    return [each.low for each in found], [each.high for each in found]


def _draw_metric(axes: Axes, results: Results, rows: pd.DataFrame, path: str, metric: str) -> None:
    positions = _positions(rows[path])
    drawn: list[Any] = []
    for label in labels(results):
        own = rows[rows["label"] == label]
        for which, line in style.LINES.items():
            column = f"{which}_{metric}"
            if not has_values(own[own["status"] == "ok"], [column]):
                continue
            table = quartiles_by(own, path, column)
            # Along the axis, where names stand in the order of the sweep.
            table = table.loc[[value for value in positions if value in table.index]]
            x = _side_by_side(positions, labels(results).index(label) - (len(labels(results)) - 1) / 2)
            colour, marker = style.colours(results)[label], style.markers(results)[label]
            low_quartile, middle, high_quartile = table[[0.25, 0.5, 0.75]].to_numpy(dtype=float).T
            axes.errorbar(
                [x[value] for value in table.index],
                middle,
                yerr=[middle - low_quartile, high_quartile - middle],
                color=colour,
                linestyle="-" if metric == "ms" else line,
                linewidth=1.1,
                elinewidth=0.9,
                marker=marker,
                markersize=4.5,
            )
            low, high = median_bounds(own, path, column, list(table.index))
            axes.vlines(
                [x[value] for value in table.index], low, high, color=colour, alpha=0.3, linewidth=4.5
            )
            drawn.append(table.to_numpy(dtype=float).ravel())
    if drawn:
        style.log_if_wide(axes, np.concatenate(drawn), ratio=4.0)
    if metric == "pose_nees":
        expected = pose_dimension(results.frames)
        axes.axhline(expected, color="#444444", linewidth=0.8, linestyle=":", zorder=0.6)
    if _logarithmic(positions):
        style.log_axis(axes, "x")
    axes.set_xticks(list(positions.values()), [value_text(value) for value in positions])
    axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)


def _with_names(rows: pd.DataFrame, path: str) -> pd.DataFrame:
    """The rows with every value at ``path`` as a name where null is among them, so that it gets a place."""
    return rows.assign(**{path: rows[path].map(value_text)}) if rows[path].isna().any() else rows


def _positions(values: pd.Series[Any]) -> dict[Any, float]:
    """Where each swept value stands on the axis: numbers at themselves, names side by side."""
    distinct = list(values.drop_duplicates().dropna())
    if all(isinstance(v, int | float | np.number) and not isinstance(v, bool | np.bool_) for v in distinct):
        return {value: float(value) for value in sorted(distinct)}
    return {value: float(index) for index, value in enumerate(distinct)}


def _logarithmic(positions: dict[Any, float]) -> bool:
    places = list(positions.values())
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in positions)
    return numbers and min(places) > 0 and max(places) > 5.0 * min(places)


def _side_by_side(positions: dict[Any, float], step: float) -> dict[Any, float]:
    """The positions moved by ``step`` times :data:`DODGE` of the axis."""
    low, high = min(positions.values()), max(positions.values())
    if _logarithmic(positions):
        factor = (high / low) ** (DODGE * step)
        return {value: place * factor for value, place in positions.items()}
    return {value: place + DODGE * step * (high - low) for value, place in positions.items()}


def _count_failures(axes: Axes, results: Results, rows: pd.DataFrame, path: str) -> None:
    positions = _positions(rows[path])
    failed = rows[rows["status"] != "ok"]
    if failed.empty:
        return
    # Room above the curves for the counts.
    axes.margins(y=0.2)
    for line, label in enumerate(labels(results)):
        for value, count in failed[failed["label"] == label].groupby(path).size().items():
            axes.annotate(
                f"{count} failed",
                (positions[value], 0.98 - 0.07 * line),
                xycoords=("data", "axes fraction"),
                color=style.colours(results)[label],
                fontsize=7.5,
                ha="center",
                va="top",
            )
