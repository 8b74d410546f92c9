"""The page's interactive figures as plain data, drawn by plotly.js, which the page carries once.

Each stands in front of its static twin, which stays for paper, for print and for browsers without scripts. A
panel is a list of traces; a trace names the back end it belongs to by its place, so that the page can give it
the colour of the reader's theme. Long series are thinned so that every peak stays.
"""

from __future__ import annotations

import base64
import functools
import gzip
import importlib.resources
import importlib.util
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from slamcmp.errors import SlamcmpError
from slamcmp.frontend.stream_file import load_stream
from slamcmp.metrics.consistency import average_band
from slamcmp.report.figures.drawable import NotDrawable, drawn_part, typical_trial
from slamcmp.report.figures.runs.consistency import binned_nis
from slamcmp.report.figures.runs.errors import COMPONENTS
from slamcmp.report.figures.sweeps.budget import budget_points
from slamcmp.report.live_sparsity import live_sparsity
from slamcmp.results.grid import (
    at_point,
    has_values,
    labels,
    middle_point,
    point_name,
    pose_dimension,
    reference_name,
    rows_of,
    swept_columns,
)
from slamcmp.results.partial import comparable
from slamcmp.results.store import Results
from slamcmp.types import IntArray

LIGHT = ("#0072B2", "#B84A00", "#007A5A", "#A8487F", "#8A5A00", "#2478A8", "#6B6B14")
DARK = ("#56B4E9", "#F08A3C", "#2BC79A", "#E29AC4", "#E6B23A", "#9AD0F5", "#C9C95A")
"""Okabe and Ito's colours, darkened and lightened until each has a contrast of 3 with its background."""
POINTS = 1200
"""Of a line, after thinning."""
STEPS = 150
"""Of the time slider."""
SIGHTS_MOST = 60
"""Measurements a frame, on average, up to which the map shows them: more would hide it."""
SEEDS_MOST = 1000
"""Trials whose points are drawn and joined; more are one grey area."""


def live_figures(results: Results) -> dict[str, Any]:
    """The data of each figure that these results can show, by name; none where plotly is not installed."""
    if importlib.util.find_spec("plotly") is None:
        return {}
    results = comparable(results)
    results = drawn_part(results) if len(results.trials) else results
    makers = {
        "map": _map,
        "errors": _errors,
        "consistency": _consistency,
        "budget": _budget,
        "seeds": _seeds,
        "sparsity": live_sparsity,
    }
    found = {}
    for name, make in makers.items():
        try:
            made = make(results) if len(results.trials) else None
        except NotDrawable:
            made = None
        if made:
            found[name] = made
    return found


def live_captions(figures: dict[str, Any], results: Results) -> dict[str, str]:
    """What the static figure's caption cannot say of the interactive one, by its name."""
    captions = {
        "errors": "Solid: online; dashed: final; dotted: ±3σ. A click on a name in the legend hides it.",
        "consistency": "A click on a name in the legend hides it.",
        "sparsity": (
            "The first slider moves the time, the second takes one variable after the other out of the "
            "matrix; framed is what is left to eliminate."
        ),
    }
    where = point_name(middle_point(results)) if "budget" in figures else ""
    of = f" at {where}" if where else ""
    captions["budget"] = f"On the Pareto front{of} nobody is both faster and better."
    runs = figures.get("map", {}).get("runs", [])
    parts = ["The slider moves the time"]
    if any("P" in run["steps"] for run in runs):
        parts.append(": the ellipse is what the back end believed then")
    if any("sights" in run["steps"] for run in runs):
        parts.append("; crosses stand where it would have placed what was measured at that moment")
    captions["map"] = f"{''.join(parts)}."
    return {name: text for name, text in captions.items() if name in figures}


def live_data(results: Results, figures: Mapping[str, Any]) -> str:
    """The figures as JSON that may stand inside a script."""
    data = {"light": LIGHT, "dark": DARK, "labels": labels(results), "figures": figures}
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace("/", "\\u002f")


@functools.cache
def plotly_script() -> str:
    """plotly.js, as its Python package ships it."""
    file = importlib.resources.files("plotly").joinpath("package_data/plotly.min.js")
    return file.read_bytes().decode("utf-8")


@functools.cache
def packed(script: str) -> str:
    """The script as a third of its size; the same bytes each time."""
    content = gzip.compress(script.encode(), compresslevel=9, mtime=0)
    return f"data:application/gzip;base64,{base64.b64encode(content).decode()}"


def kept_indices(values: ArrayLike, most: int = POINTS) -> IntArray:
    """Which of a series to draw: of each bucket the least and the largest, so that every peak stays.

    The first and the last stay as well; at most ``most`` of them, and all where they are so few.
    """
    series = np.asarray(values, dtype=float)
    if series.size <= most:
        return np.arange(series.size)
    buckets = np.array_split(np.arange(series.size), max(1, (most - 2) // 2))
    kept = {0, series.size - 1}
    for bucket in buckets:
        finite = bucket[np.isfinite(series[bucket])]
        if finite.size:
            kept |= {int(finite[series[finite].argmin()]), int(finite[series[finite].argmax()])}
    return np.array(sorted(kept))


def _numbers(values: ArrayLike, digits: int = 5) -> list[float | None]:
    """For JSON: five significant digits, nothing where there is no number."""
    return [
        float(f"{value:.{digits}g}") if np.isfinite(value) else None
        for value in np.asarray(values, dtype=float)
    ]


def _times(values: ArrayLike) -> list[float]:
    """For JSON: seconds to the millisecond; a log's own clock may count from 1970."""
    return [round(float(value), 3) for value in np.asarray(values, dtype=float)]


def _line(t: ArrayLike, y: ArrayLike, **more: Any) -> dict[str, Any]:
    kept = kept_indices(y)
    return {
        "x": _times(np.asarray(t, dtype=float)[kept]),
        "y": _numbers(np.asarray(y, dtype=float)[kept]),
        **more,
    }


def _map(results: Results) -> dict[str, Any] | None:
    if not has_values(results.frames, ["online_x", "online_y"]):
        return None
    trial = typical_trial(results)
    runs = []
    sights = _sights(results, trial)
    for index, label in enumerate(labels(results)):
        own = rows_of(results.frames, trial, label).sort_values("k")
        if own.empty:
            continue
        steps = np.unique(np.linspace(0, len(own) - 1, min(len(own), STEPS)).round().astype(int))
        shown = own.iloc[steps]
        # Paths: where either coordinate turns.
        path = np.union1d(kept_indices(own["online_x"], 500), kept_indices(own["online_y"], 500))
        run: dict[str, Any] = {"label": label, "colour": index}
        for which in ("online", "final", "true"):
            if has_values(own, [f"{which}_x"]):
                run[which] = [_numbers(own[f"{which}_{axis}"].to_numpy(float)[path]) for axis in "xy"]
        run["steps"] = {"t": _times(shown["t"]), "x": _numbers(shown["online_x"])}
        run["steps"]["y"] = _numbers(shown["online_y"])
        if sights and has_values(shown, ["online_heading_rad"]):
            run["steps"]["heading"] = _numbers(shown["online_heading_rad"])
            run["steps"]["sights"] = [sights.get(int(k), [[], []]) for k in shown["k"]]
        if has_values(own, ["online_P_xx"]):
            run["steps"]["P"] = [_numbers(shown[f"online_P_{name}"]) for name in ("xx", "xy", "yy")]
        if has_values(own, ["true_x"]):
            run["steps"]["true"] = [_numbers(shown[f"true_{axis}"]) for axis in "xy"]
        landmarks = rows_of(results.landmarks, trial, label)
        if not landmarks.empty and has_values(landmarks, ["x", "y"]):
            run["landmarks"] = [_numbers(landmarks[axis]) for axis in "xy"]
        runs.append(run)
    return {"kind": "map", "runs": runs, "reference": reference_name(results)} if runs else None


def _sights(results: Results, trial: int) -> dict[int, list[list[float | None]]]:
    """What was measured at each frame of a planar trial, as points in body axes; empty where unknown."""
    digests = results.trials.loc[results.trials["trial"] == trial, "digest"].astype(str)
    try:
        stream = load_stream(results.folder / "streams" / f"{digests.iloc[0]}.npz")
    except SlamcmpError:
        return {}
    sensor = stream.problem.sensor
    if stream.problem.T_world_body.shape != (3, 3) or not hasattr(sensor, "invert"):
        return {}
    count = sum(len(frame.ids) for frame in stream.frames)
    if not count or count > SIGHTS_MOST * len(stream.frames):
        return {}
    points = {frame.k: sensor.invert(np.eye(3), frame.z) for frame in stream.frames if len(frame.ids)}
    return {k: [_numbers(each[:, axis], 4) for axis in (0, 1)] for k, each in points.items()}


def _errors(results: Results) -> dict[str, Any] | None:
    if not has_values(results.frames, ["online_err_0"]):
        return None
    trial, dimension = typical_trial(results), pose_dimension(results.frames)
    panels = []
    for row, (name, factor) in enumerate(COMPONENTS[dimension]):
        traces = []
        for index, label in enumerate(labels(results)):
            own = rows_of(results.frames, trial, label).sort_values("k")
            for which in ("online", "final"):
                if not has_values(own, [f"{which}_err_{row}"]):
                    continue
                error = factor * own[f"{which}_err_{row}"].to_numpy(float)
                dash = "solid" if which == "online" else "dash"
                traces.append(_line(own["t"], error, colour=index, name=f"{label} {which}", dash=dash))
                if which == "online" and has_values(own, [f"online_sigma_{row}"]):
                    band = 3.0 * factor * own[f"online_sigma_{row}"].to_numpy(float)
                    traces += [
                        _line(own["t"], sign * band, colour=index, name=f"{label} ±3σ", dash="dot", thin=True)
                        for sign in (-1.0, 1.0)
                    ]
        panels.append({"y": name, "traces": traces})
    return {"kind": "stack", "x": "time [s]", "panels": panels}


def _consistency(results: Results) -> dict[str, Any] | None:
    ok = at_point(results.trials, middle_point(results))
    ok = ok[ok["status"] == "ok"]
    frames = results.frames.merge(ok[["trial", "label"]], on=["trial", "label"])
    panels: list[dict[str, Any]] = []
    dof = pose_dimension(frames)
    for which in ("online", "final"):
        if has_values(frames, [f"{which}_nees"]):
            used = frames[frames[f"{which}_nees"] > 0]
            means = used.groupby(["label", "t"])[f"{which}_nees"].mean()
            runs = int(used.groupby("label")["trial"].nunique().min())
            low, high = (float(each) for each in average_band(dof, runs))
            traces = [
                _line(means[label].index, means[label], colour=index, name=label)
                for index, label in enumerate(labels(results))
                if label in means.index.get_level_values(0)
            ]
            panels.append({"y": f"{which} pose NEES", "band": [low, high], "log": True, "traces": traces})
    if has_values(frames, ["nis", "nis_dof"]):
        traces = []
        for index, label in enumerate(labels(results)):
            own = frames[(frames["label"] == label) & (frames["nis_dof"] > 0) & frames["nis"].notna()]
            if not own.empty:
                time, ratio, summed = binned_nis(own)
                spread = 1.96 * float(np.sqrt(2.0 / np.median(summed)))
                band = [max(1.0 - spread, 0.01), 1.0 + spread]
                traces.append(_line(time, ratio, colour=index, name=label))
        if traces:
            panels.append({"y": "NIS / dof", "band": band, "log": True, "traces": traces})
    return {"kind": "stack", "x": "time [s]", "panels": panels} if panels else None


def _budget(results: Results) -> dict[str, Any] | None:
    trials = results.trials[results.trials["status"] == "ok"]
    if not has_values(trials, ["update_s"]):
        return None
    panels = []
    for which in ("online", "final"):
        if not has_values(trials, [f"{which}_ate"]):
            continue
        table = budget_points(trials, which)
        traces: list[dict[str, Any]] = []
        for index, label in enumerate(labels(results)):
            own = table[table["label"] == label]
            if own.empty:
                continue
            shared = {"colour": index, "name": label}
            x, y = own["ms"].to_numpy(float), own["error_m"].to_numpy(float)
            traces.append({"x": _numbers(x), "y": _numbers(y), "marks": 5, **shared})
            traces.append({**_medians(own), "marks": 12, **shared})
        here = at_point(table, middle_point(results))
        front = pareto_front(here.groupby("label")[["ms", "error_m"]].median())
        if len(front) > 1:
            traces.append(
                {"x": _numbers(front["ms"]), "y": _numbers(front["error_m"]), "name": "Pareto front"}
            )
        panels.append({"y": f"{which} ATE [m]", "log": True, "traces": traces})
    return {"kind": "stack", "x": "ms per frame", "logx": True, "panels": panels} if panels else None


def _medians(own: pd.DataFrame) -> dict[str, Any]:
    """The median of each grid point, joined, and how far its quartiles are away."""
    points = own.groupby(swept_columns(own) or "label", sort=False, dropna=False)[["ms", "error_m"]]
    low, middle, high = (points.quantile(share).to_numpy(float) for share in (0.25, 0.5, 0.75))
    return {
        "x": _numbers(middle[:, 0]),
        "y": _numbers(middle[:, 1]),
        "bars": [[_numbers((high - middle)[:, axis]), _numbers((middle - low)[:, axis])] for axis in (0, 1)],
    }


def pareto_front(points: pd.DataFrame) -> pd.DataFrame:
    """The points that no other one beats in both columns, ``ms`` and ``error_m``, the fastest first."""
    ordered = points.dropna().sort_values(["ms", "error_m"])
    best = ordered["error_m"].cummin().shift(fill_value=np.inf)
    return ordered[ordered["error_m"] < best]


def _seeds(results: Results) -> dict[str, Any] | None:
    """The error of each run, those of one trial joined."""
    here = at_point(results.trials, middle_point(results))
    here = here[here["status"] == "ok"]
    panels = []
    for which in ("online", "final"):
        if not has_values(here, [f"{which}_ate"]):
            continue
        values = here.pivot(index="trial", columns="label", values=f"{which}_ate")
        known = [label for label in labels(results) if label in values and values[label].notna().any()]
        order = [labels(results).index(label) for label in known]
        drawn = values[known].head(SEEDS_MOST)
        part = f" (first {len(drawn)} of {len(values)} trials)" if len(drawn) < len(values) else ""
        rows = [_numbers(row) for row in drawn.to_numpy(float)]
        panels.append({"y": f"{which} ATE [m]{part}", "labels": known, "colours": order, "rows": rows})
    many = any(len(panel["rows"]) > 1 for panel in panels)
    shown = [each for each in labels(results) if any(each in panel["labels"] for panel in panels)]
    return {"kind": "seeds", "order": shown, "panels": panels} if many else None
