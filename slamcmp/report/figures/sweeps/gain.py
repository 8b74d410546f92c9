"""What each back end gains over the first one, and what its gain costs: over a sweep, on paired runs."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcmp.metrics.statistics import Interval, mean_interval, ratio_interval
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.sweeps.cells import Cells, cells
from slamcmp.results.answers.candidates import find_candidates
from slamcmp.results.grid import at_point, has_values, labels, milliseconds_per_frame, point_name, value_text
from slamcmp.results.store import Results
from slamcmp.results.words import parameter_words

ODOMETRY = "dead_reckoning"
"""The back end that knows nothing but the odometry: what bits are gained over."""
_LIMIT = (0.02, 50.0)
"""Of a ratio that is drawn: a back end that diverged is beyond any axis."""


def measured_by(results: Results) -> str:
    """The label that the others' errors are divided by: the first one that is no odometry alone.

    Raises:
        NotDrawable: there is none.
    """
    alone = _odometry_labels(results)
    for label in labels(results):
        if label not in alone:
            return label
    raise NotDrawable("there is nobody but the odometry")


@figures.register(
    "gain",
    title="Gain over the first back end",
    needs=("trials: two or three swept paths", "trials: online_ate"),
    caption=(
        "Error of each back end over the online error of the first one that estimates anything, run by run "
        "(geometric mean and 95 % interval): below 1 is better. Dashed, hollow: online; solid, full: with "
        "hindsight, which is why it is a line of its own. Each panel is one cell of the sweep's other paths."
    ),
)
def plot_gain(results: Results) -> Figure:
    """Ratio of errors to the first back end's online error over the last swept path, with intervals."""
    of, base = cells(results), measured_by(results)
    if not has_values(results.trials, ["online_ate"]):
        raise NotDrawable("no run has an online error")
    rows, columns = len(of.panel_values), len(of.down_values)
    figure = style.new_figure(3.1 * columns + 0.6, 2.3 * rows + 1.2, f"Error over {base}'s online error")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    shown = _draw_gain(grid, results, of, base)
    for (i, j), axes in np.ndenumerate(grid):
        axes.axhline(1.0, color="#444444", linewidth=0.8, linestyle=":")
        where = point_name({of.down: of.down_values[j]})
        axes.set_title(f"{of.panel_title(i)}, {where}" if of.panel else where, fontsize=8.5)
        axes.set_xticks(range(len(of.across_values)), [value_text(value) for value in of.across_values])
        style.log_axis(axes, "y")
    for axes in grid[-1]:
        axes.set_xlabel(parameter_words(of.across))
    for axes in grid[:, 0]:
        axes.set_ylabel("ratio of ATE")
    colours, markers = style.colours(results), style.markers(results)
    keys = [style.line_key(label, color=colours[label], marker=markers[label]) for label in shown]
    keys += [style.line_key(which, color="#555555", linestyle=line) for which, line in style.LINES.items()]
    style.legend_below(figure, keys, columns=max(2, 2 * columns))
    return figure


def frontier_table(results: Results) -> pd.DataFrame:
    """A row a grid point and back end: bits gained over the odometry, with interval, claimed ones, cost."""
    alone = _odometry_labels(results)
    if not alone:
        raise NotDrawable("no back end is the odometry alone (dead_reckoning): bits are gained over it")
    column = "online_pose_log_score_bits"
    if not has_values(results.trials, [column]):
        raise NotDrawable("no run has a logarithmic score")
    trials = results.trials.assign(ms=milliseconds_per_frame(results.trials, "update_s", "estimate_s"))
    rows = []
    for _, _, _, point in cells(results).each():
        here = at_point(trials, point)
        ok = here[here["status"] == "ok"]
        scores, entropy = (
            ok.pivot_table(index="trial", columns="label", values=name)
            for name in (column, "online_pose_entropy_bits")
        )
        own = [each.label for each in find_candidates(results, point=point)]
        for label in own:
            if label in alone or label not in scores or alone[0] not in scores:
                continue
            gained = mean_interval((scores[label] - scores[alone[0]]).dropna())
            claimed = float((entropy[alone[0]] - entropy[label]).mean())
            ms = float(ok.loc[ok["label"] == label, "ms"].median())
            rows.append(
                {
                    **point,
                    "back end": label,
                    "bits gained": gained.estimate,
                    "low": gained.low,
                    "high": gained.high,
                    "bits claimed": claimed,
                    "ms a frame": ms,
                    "bits per ms": gained.estimate / ms if ms > 0 else math.nan,
                }
            )
    return pd.DataFrame(rows)


@figures.register(
    "frontier",
    title="Bits for milliseconds",
    needs=("trials: two or three swept paths", "trials: online_pose_log_score_bits, times", "dead_reckoning"),
    caption=(
        "What a frame's time buys online: bits gained over the odometry alone (mean difference of the "
        "logarithmic score of the true pose, with its 95 % interval from 50 runs on) against time per frame, "
        "in the middle of the other paths. Hollow: what the covariance claims to have gained; a hollow mark "
        "above its full one is overconfidence. The line joins those that nobody beats in both. Axes end at "
        "0 bits: below, an estimate is worth less than the odometry."
    ),
    table=frontier_table,
)
def plot_frontier(results: Results) -> Figure:
    """Bits gained over the odometry against time per frame, a panel for each value of the last swept path."""
    of, table = cells(results), frontier_table(results)
    middle = {of.down: of.down_values[len(of.down_values) // 2]}
    if of.panel is not None:
        middle[of.panel] = of.panel_values[len(of.panel_values) // 2]
    at = point_name(middle)
    columns = len(of.across_values)
    figure = style.new_figure(3.0 * columns + 0.6, 4.0, f"Bits for milliseconds, online: {at}")
    grid = figure.subplots(1, columns, squeeze=False, sharex=True, sharey=True)[0]
    shown: dict[str, None] = {}
    for axes, value in zip(grid, of.across_values, strict=True):
        rows = at_point(table, {**middle, of.across: value})
        shown |= dict.fromkeys(rows["back end"])
        _draw_frontier(axes, results, rows)
        axes.set_title(point_name({of.across: value}))
        axes.set_xlabel("ms a frame")
    grid[0].set_ylabel("bits over the odometry")
    grid[0].set_ylim(bottom=0.0)
    colours, markers = style.colours(results), style.markers(results)
    keys = [
        style.line_key(label, color=colours[label], marker=markers[label], linestyle="") for label in shown
    ]
    style.legend_below(figure, keys)
    return figure


def unbeaten(cost: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Places of those that nobody beats in cost and gain, (n,) each, from the cheapest on."""
    order = np.lexsort((-gain, cost))
    best, kept = -math.inf, []
    for place in order:
        if gain[place] > best:
            best = gain[place]
            kept.append(place)
    return np.array(kept, dtype=np.int64)


def _draw_gain(grid: np.ndarray, results: Results, of: Cells, base: str) -> list[str]:
    """Draw the curves; returns the labels drawn, in the table's order."""
    colours, markers = style.colours(results), style.markers(results)
    alone, shown = _odometry_labels(results), []
    known = [label for label in labels(results) if label not in alone]
    online = {
        _key(point): {c.label for c in find_candidates(results, point=point)} for *_, point in of.each()
    }
    for index, label in enumerate(known):
        for which, line in style.LINES.items():
            if which == "online" and label == base:
                continue
            found = np.full((*grid.shape, len(of.across_values), 3), math.nan)
            for i, j, k, point in of.each():
                if which == "online" and label not in online[_key(point)]:
                    continue
                ratio = _against_online(results, point, label, base, which)
                found[i, j, k] = ratio.estimate, ratio.low, ratio.high
            if np.isnan(found[..., 0]).all():
                continue
            shown.append(label)
            found[(found[..., 0] < _LIMIT[0]) | (found[..., 0] > _LIMIT[1])] = math.nan
            x = np.arange(len(of.across_values)) + 0.04 * (index - len(known) / 2)
            for (i, j), axes in np.ndenumerate(grid):
                middle, low, high = found[i, j].T
                axes.errorbar(
                    x,
                    middle,
                    yerr=[middle - low, high - middle],
                    color=colours[label],
                    marker=markers[label],
                    markersize=4,
                    linestyle=line,
                    linewidth=1.0,
                    elinewidth=0.8,
                    markerfacecolor="white" if which == "online" else colours[label],
                )
    return list(dict.fromkeys(shown))


def _key(point: dict[str, object]) -> str:
    """A grid point as a key."""
    return repr(sorted(point.items()))


def _against_online(
    results: Results, point: dict[str, object], label: str, base: str, which: str
) -> Interval:
    """Error of that kind over the base's online error."""
    rows = at_point(results.trials, point)
    ok = rows[rows["status"] == "ok"].set_index("trial")
    if f"{which}_ate" not in ok:
        return Interval(math.nan, math.nan, math.nan, 0)
    pairs = pd.concat(
        [ok.loc[ok["label"] == label, f"{which}_ate"], ok.loc[ok["label"] == base, "online_ate"]],
        axis=1,
        join="inner",
    ).dropna()
    if pairs.empty:
        return Interval(math.nan, math.nan, math.nan, 0)
    return ratio_interval(pairs.iloc[:, 0], pairs.iloc[:, 1])


def _draw_frontier(axes: Axes, results: Results, rows: pd.DataFrame) -> None:
    colours, markers = style.colours(results), style.markers(results)
    for row in rows.to_dict("records"):
        label, ms = row["back end"], row["ms a frame"]
        axes.plot(
            ms,
            row["bits claimed"],
            markers[label],
            color=colours[label],
            markerfacecolor="none",
            markersize=6,
        )
        error = [[row["bits gained"] - row["low"]], [row["high"] - row["bits gained"]]]
        axes.errorbar(
            ms, row["bits gained"], yerr=None if np.isnan(error).any() else error, color=colours[label],
            marker=markers[label], markersize=7,
        )  # fmt: skip
    usable = rows[np.isfinite(rows["bits gained"]) & np.isfinite(rows["ms a frame"])]
    line = unbeaten(usable["ms a frame"].to_numpy(float), usable["bits gained"].to_numpy(float))
    best = usable.iloc[line]
    axes.plot(best["ms a frame"], best["bits gained"], color="#777777", linewidth=0.9, zorder=0.5)
    style.log_axis(axes, "x")


def _odometry_labels(results: Results) -> list[str]:
    """Labels of back ends that are the odometry alone."""
    chosen = results.manifest.get("config", {}).get("back_ends", [])
    return [str(each.get("label", each["name"])) for each in chosen if each.get("name") == ODOMETRY]
