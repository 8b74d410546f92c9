"""Where which back end is the one to take, and where each can be believed: maps over a sweep."""

from __future__ import annotations

import textwrap
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.report.figures.sweeps.cells import Cells, cells, panels
from slamcmp.results.answers.candidates import find_candidates
from slamcmp.results.answers.recommendation import RECOMMENDED, TOO_FEW, Recommendation, choose
from slamcmp.results.grid import at_point, labels, pose_dimension
from slamcmp.results.numbers import number_text
from slamcmp.results.store import Results

_OPEN = "#E3E3E3"
_NOBODY = "#FFFFFF"


def regime_table(results: Results) -> pd.DataFrame:
    """A row a grid point: the verdict of the rule, the back end, its error against the best, and the best."""
    rows = []
    for _, _, _, point in cells(results).each():
        found = choose(find_candidates(results, point=point))
        taken = None if found.label is None else found.of(found.label)
        rows.append(
            {
                **point,
                "verdict": found.verdict,
                "take": found.label or "–",
                "error over the best": "–"
                if taken is None
                else _ratio(taken.ratio.estimate, taken.ratio.high),
                "ms a frame": "–" if taken is None else number_text(taken.candidate.cost_ms),
                "lowest error": found.best or "–",
                "why not": found.reason or "–",
            }
        )
    return pd.DataFrame(rows)


@figures.register(
    "regimes",
    title="Which back end to take",
    needs=("trials: two or three swept paths", "trials: online_ate"),
    caption=(
        "In each cell the cheapest back end that is within 5 % of the best online error (its whole 95 % "
        "interval, on paired runs) and consistent by its NEES. Pale: more runs would tell; a name with a "
        "question mark would be it, but a cheaper one might be within as well. White: nobody is within 5 % "
        "and consistent. A name in brackets has the lowest error, and no more is known of it."
    ),
    table=regime_table,
)
def plot_regimes(results: Results) -> Figure:
    """The cheapest back end within 5 % of the best online error and consistent, over the sweep."""
    of = cells(results)
    found = [(place, choose(find_candidates(results, point=point))) for *place, point in of.each()]
    if all(each.best is None for _, each in found):
        raise NotDrawable("no back end has an online error of its own")
    colours = style.colours(results)
    figure, axes = panels(of, "Which back end to take online", cell=(1.25, 0.72))
    for (i, row, column), each in found:
        colour = _OPEN if each.verdict == TOO_FEW else _NOBODY
        if each.verdict == RECOMMENDED and each.label is not None:
            colour = colours[each.label]
        _cell(axes[i], row, column, colour, _said(each))
    taken = [
        label
        for label in labels(results)
        if any(e.label == label and e.verdict == RECOMMENDED for _, e in found)
    ]
    keys = [Patch(facecolor=colours[label], label=label) for label in taken]
    keys += [
        Patch(facecolor=_OPEN, edgecolor="#888888", label="not enough runs to say"),
        Patch(facecolor=_NOBODY, edgecolor="#888888", label="nobody within 5 % and consistent"),
    ]
    style.legend_below(figure, keys, columns=4)
    return figure


def honesty_table(results: Results) -> pd.DataFrame:
    """A row a back end and grid point: NEES, its verdict, failed runs."""
    rows = []
    for _, _, _, point in cells(results).each():
        for each in find_candidates(results, point=point):
            rows.append(
                {
                    "back end": each.label,
                    **point,
                    "online": each.consistency.verdict,
                    "judged by": each.consistency.text,
                    "failed": f"{len(each.failures)} of {each.runs}",
                }
            )
    return pd.DataFrame(rows)


@figures.register(
    "honesty",
    title="Where each can be believed, and where it fails",
    needs=("trials: two or three swept paths", "trials: online_pose_nees"),
    caption=(
        "Mean online pose NEES of each back end over the number of its dimensions, at every grid point: 1 is "
        "honest; red, with a cross: overconfident (its 95 % interval, or the band at the last frame, lies "
        "above). A number: share of its runs that failed. Rows are grouped by back end."
    ),
    table=honesty_table,
)
def plot_honesty(results: Results) -> Figure:
    """Online NEES over its dimension and failed runs, of each back end at each grid point."""
    of = cells(results)
    shown = [each for each in labels(results) if _has_nees(results, each)]
    if not shown:
        raise NotDrawable("no back end has an online NEES")
    dimension = pose_dimension(results.frames)
    down = len(of.down_values)
    title = "Online NEES over its expectation, and failed runs"
    tall = Cells(
        of.panel, of.down, of.across, of.panel_values, tuple(of.down_values) * len(shown), of.across_values
    )
    figure, axes = panels(tall, title, cell=(0.62, 0.27))
    norm, scale = TwoSlopeNorm(0.0, -2.0, 2.0), matplotlib.colormaps["RdBu_r"]
    for i, row, column, point in of.each():
        known = {each.label: each for each in find_candidates(results, point=point, names=shown)}
        for b, label in enumerate(shown):
            own = at_point(results.trials, point)
            own = own[own["label"] == label]
            ok = own[own["status"] == "ok"]["online_pose_nees"].dropna()
            value = float(ok.mean()) / dimension if len(ok) else np.nan
            colour = (
                "#DDDDDD" if np.isnan(value) else scale(norm(np.clip(np.log2(max(value, 1e-9)), -2.0, 2.0)))
            )
            failed = int((own["status"] != "ok").sum())
            over = label in known and known[label].consistency.verdict == "overconfident"
            text = f"{100 * failed / len(own):.0f} %" if failed else ("×" if over else "")
            _cell(axes[i], b * down + row, column, to_rgb(colour), text, size=7.0)
    for each in axes:
        for b in range(len(shown)):
            each.axhline(b * down - 0.5, color="#222222", linewidth=1.2)
    names = axes[0].secondary_yaxis(-0.32 / len(of.across_values) * 2)
    names.set_yticks([(b + 0.5) * down - 0.5 for b in range(len(shown))], shown, fontweight="bold")
    names.tick_params(length=0)
    names.spines["left"].set_visible(False)
    bar = figure.colorbar(
        matplotlib.cm.ScalarMappable(norm, scale), ax=axes, orientation="horizontal", aspect=40, shrink=0.6
    )
    bar.set_ticks([-2, -1, 0, 1, 2], labels=["≤ ¼", "½", "1", "2", "≥ 4"])
    bar.set_label("NEES over its expectation")
    return figure


def _has_nees(results: Results, label: str) -> bool:
    own = results.trials[results.trials["label"] == label]
    return "online_pose_nees" in own and bool(own["online_pose_nees"].notna().any())


def _said(found: Recommendation) -> str:
    if found.verdict == RECOMMENDED:
        return found.label or ""
    if found.label is not None:
        return f"{found.label} (?)"
    return f"({found.best})" if found.best is not None else ""


def _cell(axes: Axes, row: int, column: int, colour: Any, text: str, *, size: float = 8.0) -> None:
    place = (column - 0.5, row - 0.5)
    axes.add_patch(Rectangle(place, 1, 1, facecolor=colour, edgecolor="white", linewidth=1.2))
    red, green, blue = to_rgb(colour)
    ink = "white" if 0.299 * red + 0.587 * green + 0.114 * blue < 0.55 else "black"
    axes.text(column, row, textwrap.fill(text, 14), ha="center", va="center", fontsize=size, color=ink)


def _ratio(estimate: float, high: float) -> str:
    return f"{estimate:.2f} (at most {high:.2f})"
