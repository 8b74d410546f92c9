"""How sure an experiment's numbers are: intervals over the runs, failures, the worst run, average NEES."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pandas as pd

from slamcmp.metrics.statistics import (
    AverageNees,
    average_nees,
    mean_interval,
    median_interval,
    wilson_interval,
)
from slamcmp.results.grid import (
    at_point,
    grid_points,
    has_values,
    labels,
    own_columns,
    own_points,
    pose_dimension,
    swept_columns,
)
from slamcmp.results.numbers import interval_text, number_text, share_text
from slamcmp.results.partial import comparable
from slamcmp.results.store import Results


def runs_by_point(results: Results) -> Iterator[tuple[dict[str, Any], str, pd.DataFrame]]:
    """Grid point, label and runs, point by point and back end by back end.

    A back end comes once for each combination of the values that it has: never again for a parameter of
    another one. A value that is not its own is in no point.
    """
    swept = swept_columns(results.trials)
    points = {label: own_points(results.trials, label) for label in labels(results)}
    for index, point in enumerate(grid_points(results.trials)):
        here = at_point(results.trials, point)
        for label, mine in points.items():
            own = here[here["label"] == label]
            if not own.empty and index in mine:
                yield {path: point[path] for path in own_columns(swept, label)}, label, own


def certainty_table(results: Results) -> pd.DataFrame:
    """One row per grid point, back end and trajectory with an ATE, over the runs that are ok.

    Failure rate with Wilson's interval, median with the distribution-free interval, mean (from 50 runs on
    with an interval), the worst run with its seed, and the ANEES of the last frame with the band for that
    many runs. Without any ATE only the failure rate is left.
    """
    results = comparable(results)
    rows: list[dict[str, Any]] = []
    for point, label, own in runs_by_point(results):
        for which in [w for w in ("online", "final") if has_values(own, [f"{w}_ate"])] or [""]:
            rows.append(_row(results, point, label, own, which))
    return pd.DataFrame(rows)


def failure_rate(own: pd.DataFrame) -> str:
    """Share of the runs that are not ok, with its interval."""
    return share_text(wilson_interval(int((own["status"] != "ok").sum()), len(own)))


def worst_run(own: pd.DataFrame, column: str) -> tuple[float, str]:
    """The largest value among the runs that are ok, and the seed it belongs to; NaN without any."""
    ok = own[(own["status"] == "ok") & own[column].notna()]
    if ok.empty:
        return math.nan, ""
    row = ok.iloc[int(ok[column].to_numpy(dtype=float).argmax())]
    return float(row[column]), "" if pd.isna(row["seed"]) else str(int(row["seed"]))


def last_frame_nees(results: Results, own: pd.DataFrame, which: str = "online") -> AverageNees:
    """ANEES over the finished runs at the log's last frame: there each run gives one independent value."""
    dof = pose_dimension(results.frames)
    column, ok = f"{which}_nees", own[own["status"] == "ok"]
    if column not in results.frames or ok.empty:
        return average_nees([], dof)
    mine = results.frames["label"] == ok["label"].iloc[0]
    frames = results.frames[["trial", "k", column]][mine & results.frames["trial"].isin(ok["trial"])]
    return average_nees(frames.sort_values("k").groupby("trial")[column].last(), dof)


def _row(
    results: Results, point: dict[str, Any], label: str, own: pd.DataFrame, which: str
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "back end": label,
        **{path: point.get(path) for path in swept_columns(own)},
        "runs": len(own),
        "failed (95 %)": failure_rate(own),
        "trajectory": which,
    }
    if not which:
        return row
    ok = own[own["status"] == "ok"][f"{which}_ate"]
    median, mean = median_interval(ok), mean_interval(ok)
    worst, seed = worst_run(own, f"{which}_ate")
    nees = last_frame_nees(results, own, which)
    return row | {
        "median ATE [m]": median.estimate,
        "95 % of the median": interval_text(median),
        "mean ATE [m]": mean.estimate,
        "95 % of the mean": interval_text(mean),
        "worst ATE [m]": worst,
        "its seed": seed,
        "ANEES, last frame": nees.average,
        "95 % band": f"{number_text(nees.low)} to {number_text(nees.high)}" if nees.runs else "",
        "verdict": nees.verdict,
    }
