"""Where a front end without labels took one landmark for another, stream by stream."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slamcmp.geometry import transform
from slamcmp.metrics.association import association_scores, identities, right
from slamcmp.registry import figures
from slamcmp.report.figures import style
from slamcmp.report.figures.drawable import NotDrawable
from slamcmp.results.runs.run_file import StoredTruth
from slamcmp.results.runs.streams import known_streams
from slamcmp.results.store import Results
from slamcmp.types import Association
from slamcmp.types.association import NO_LANDMARK

MOST = 6
"""Streams that are drawn."""
RIGHT, WRONG, LEFT_OUT = "#0072B2", "#D55E00", "#999999"


@figures.register(
    "decisions",
    title="Association without labels",
    needs=("a front end without labels (associated), and labels to score it by",),
    caption=(
        "Each dot is a detection, at its time and in the row of the landmark that it truly is of. A wrong "
        "one is joined with the row of the landmark that it was taken for; a cross is one without a "
        "counterpart: clutter that was believed, or a landmark that was started twice. Right, where true "
        "poses are known: the same from above. At most six streams are drawn, the worst first."
    ),
)
def plot_decisions(results: Results) -> Figure:
    """Every detection over time and, where the truth is known, the wrong ones on the map."""
    streams = _scored(results)
    if not streams:
        raise NotDrawable("no stream of a front end without labels, or none with labels to score it by")
    mapped = any(known.truth is not None for _, known in streams)
    figure = style.new_figure(
        11.0, 0.8 + 2.5 * len(streams), "Whose did the front end think each detection was?"
    )
    grid = figure.add_gridspec(len(streams), 2 if mapped else 1, width_ratios=[2.0, 1.0] if mapped else [1.0])
    for row, (name, known) in enumerate(streams):
        assert known.association is not None
        axes = figure.add_subplot(grid[row, 0])
        _draw_times(axes, known, known.association)
        scores = association_scores(known.association)
        axes.set_title(
            f"{name}: precision {100 * scores['association_precision']:.1f} %, "
            f"recall {100 * scores['association_recall']:.1f} %"
        )
        if known.truth is not None:
            _draw_map(figure.add_subplot(grid[row, 1]), known, known.association)
        if row == len(streams) - 1:
            axes.set_xlabel("time [s]" if known.truth is not None else "frame")
    style.legend_below(
        figure,
        [
            style.line_key("right", color=RIGHT, marker=".", linestyle="none"),
            style.line_key("wrong", color=WRONG, marker="o", markersize=4),
            style.line_key("without counterpart", color=WRONG, marker="x", linestyle="none"),
            style.line_key("left out", color=LEFT_OUT, marker=".", linestyle="none"),
        ],
    )
    return figure


def _scored(results: Results) -> list[tuple[str, StoredTruth]]:
    """The worst streams that can be scored, with the names of their trials."""
    names = {}
    swept = [name for name in results.trials.columns if "." in name]
    for row in results.trials.drop_duplicates("digest").to_dict("records"):
        values = ", ".join(f"{path.rpartition('.')[2]} {row[path]}" for path in swept)
        names[row["digest"]] = f"trial {row['trial']}" + (f" ({values})" if values else "")
    found = [
        (association_scores(known.association)["association_precision"], names[digest], known)
        for digest, known in known_streams(results.folder).items()
        if known.association is not None and digest in names
    ]
    found = [each for each in found if not np.isnan(each[0])]
    return [(name, known) for _, name, known in sorted(found, key=lambda each: each[0])[:MOST]]


def _columns(association: Association) -> dict[str, NDArray[Any]]:
    """Of every detection: frame, label, whether right, whether left out, and what it was taken for."""
    landmark_of = identities(association)
    sizes = [ids.size for ids in association.ids]
    ids = np.concatenate(association.ids)
    return {
        "frame": np.repeat(np.arange(len(sizes)), sizes),
        "label": np.concatenate(association.labels),
        "right": np.concatenate(right(association)),
        "out": ids == NO_LANDMARK,
        "taken": np.array([landmark_of.get(name, -1) for name in ids.tolist()], dtype=np.int64),
    }


def _draw_times(axes: Axes, known: StoredTruth, association: Association) -> None:
    each = _columns(association)
    t = (np.arange(known.frames) if known.truth is None else known.truth.t)[each["frame"]]
    known_labels = np.unique(each["label"][each["label"] >= 0]).tolist()
    y = {label: row for row, label in enumerate(known_labels)}
    at = np.array([y.get(int(label), -1) for label in each["label"]])
    for mask, colour, size in ((each["out"], LEFT_OUT, 2.0), (each["right"], RIGHT, 2.0)):
        axes.plot(t[mask], at[mask], ".", color=colour, markersize=size)
    for i in np.flatnonzero(~each["right"] & ~each["out"]).tolist():
        taken = y.get(int(each["taken"][i]))
        if taken is None or at[i] < 0 or taken == at[i]:
            axes.plot(t[i], at[i] if taken is None else taken, "x", color=WRONG, markersize=4)
        else:
            axes.plot([t[i], t[i]], [at[i], taken], "-", color=WRONG, linewidth=0.8)
            axes.plot(t[i], at[i], "o", color=WRONG, markersize=3)
    axes.set_ylabel("true landmark")


def _draw_map(axes: Axes, known: StoredTruth, association: Association) -> None:
    truth = known.truth
    assert truth is not None
    landmark_of = identities(association)
    place = {landmark_of[int(name)]: truth.positions[row] for row, name in enumerate(truth.ids)}
    axes.plot(*truth.T_world_body[:, :2, -1].T, color=style.TRUTH, linewidth=0.6, alpha=0.6)
    axes.plot(*truth.positions[:, :2].T, "+", color=style.TRUTH, markersize=5)
    each = _columns(association)
    points = np.concatenate(association.points)
    for i in np.flatnonzero(~each["right"] & ~each["out"]).tolist():
        x, y = transform(truth.T_world_body[each["frame"][i]], points[i])[:2]
        taken = place.get(int(each["taken"][i]))
        if taken is None:
            axes.plot(x, y, "x", color=WRONG, markersize=4)
        else:
            axes.plot([x, taken[0]], [y, taken[1]], "-", color=WRONG, linewidth=0.8)
            axes.plot(x, y, "o", color=WRONG, markersize=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("from above [m]")
