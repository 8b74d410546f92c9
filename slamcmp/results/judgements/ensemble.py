"""Metrics of all runs together, as many publications print them, from the frames table.

With e the error of run i at frame k: ``ensemble_…_rmse`` is the root mean square of e over runs at each
frame, then the root mean square of that over the frames, which is the root mean square over both.
``ensemble_mean_…_rmse`` takes the mean over the frames in its place. ``ensemble_nees_…`` is the mean over
runs and frames divided by the dimension, so that 1 is consistent; the first ten frames count as 0, as in
the benchmark of the ukfm project, where a start known exactly makes their NEES meaningless.

They are meant for reproducing such numbers: frames of one run depend on each other, so intervals and tests
use :func:`run_values`, one value a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from slamcmp.results.grid import pose_dimension
from slamcmp.types import FloatArray

COLUMNS = (
    *("trial", "k", "true_x", "true_y", "online_x", "online_y", "online_P_xx", "online_P_xy", "online_P_yy"),
    *(
        "online_position_error_m",
        "online_heading_error_deg",
        "online_err_2",
        "online_err_5",
        "online_sigma_2",
    ),
    "online_nees",
)
"""Of the frames' table: all that these metrics are made of."""
FIRST_FRAMES = 10
"""NEES counts as 0 there."""


@dataclass(frozen=True)
class EnsembleMetric:
    """How one of them is computed."""

    unit: str
    description: str
    per_frame: Callable[[pd.DataFrame], FloatArray]
    """Squared error or NEES of every row of a frames table."""
    average: Literal["rms", "mean_of_rms", "mean"]


def ensemble_value(name: str, frames: pd.DataFrame) -> float:
    """The metric over the frames of several runs of one back end; NaN where a needed value is missing."""
    metric, table = ENSEMBLE_METRICS[name], _by_run(name, frames)
    if not table.size:
        return math.nan
    if metric.average == "mean":
        return float(table.mean())
    over_runs = table.mean(axis=0)
    if metric.average == "rms":
        return math.sqrt(float(over_runs.mean()))
    return float(np.sqrt(over_runs).mean())


def run_values(name: str, frames: pd.DataFrame) -> pd.Series:
    """The same statistic of each run alone, by trial: root mean square over frames, or mean NEES."""
    table = _by_run(name, frames)
    means = table.mean(axis=1) if table.size else np.empty(0)
    values = means if ENSEMBLE_METRICS[name].average == "mean" else np.sqrt(means)
    return pd.Series(values, index=pd.Index(np.unique(frames["trial"]), name="trial"), dtype=float)


def _by_run(name: str, frames: pd.DataFrame) -> FloatArray:
    """(runs, frames), rows in the order of the trials."""
    if frames.empty:
        return np.empty((0, 0))
    ordered = in_order(frames)
    values = ENSEMBLE_METRICS[name].per_frame(ordered)
    return values.reshape(ordered["trial"].nunique(), -1)


def in_order(frames: pd.DataFrame) -> pd.DataFrame:
    """By trial and frame; rows that already stand so are not moved."""
    trial, k = frames["trial"].to_numpy(), frames["k"].to_numpy()
    step = np.diff(trial)
    sorted_already = bool(((step > 0) | ((step == 0) & (np.diff(k) >= 0))).all())
    return frames if sorted_already else frames.sort_values(["trial", "k"])


def _column(frames: pd.DataFrame, name: str) -> FloatArray:
    if name not in frames.columns:
        return np.full(len(frames), math.nan)
    values: FloatArray = frames[name].to_numpy(np.float64)
    return values


def _squared_heading(frames: pd.DataFrame) -> FloatArray:
    return _column(frames, "online_heading_error_deg") ** 2


def _squared_position(frames: pd.DataFrame) -> FloatArray:
    return _column(frames, "online_position_error_m") ** 2


def _from_frame_ten(nees: FloatArray, frames: pd.DataFrame) -> FloatArray:
    return np.where(frames["k"].to_numpy() < FIRST_FRAMES, 0.0, nees)


def _heading_nees(frames: pd.DataFrame) -> FloatArray:
    if pose_dimension(frames) == 6:
        # Of a rotation in space the table holds no covariance, only its diagonal.
        return np.full(len(frames), math.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        nees = (_column(frames, "online_err_2") / _column(frames, "online_sigma_2")) ** 2
    return _from_frame_ten(nees, frames)


def _position_nees(frames: pd.DataFrame) -> FloatArray:
    if pose_dimension(frames) == 6:
        return np.full(len(frames), math.nan)
    x = _column(frames, "true_x") - _column(frames, "online_x")
    y = _column(frames, "true_y") - _column(frames, "online_y")
    P_xx, P_xy, P_yy = (_column(frames, f"online_P_{axes}") for axes in ("xx", "xy", "yy"))
    with np.errstate(divide="ignore", invalid="ignore"):
        nees = (P_yy * x**2 - 2 * P_xy * x * y + P_xx * y**2) / (P_xx * P_yy - P_xy**2)
    return _from_frame_ten(nees / 2, frames)


def _pose_nees(frames: pd.DataFrame) -> FloatArray:
    return _from_frame_ten(_column(frames, "online_nees") / pose_dimension(frames), frames)


ENSEMBLE_METRICS: dict[str, EnsembleMetric] = {
    "ensemble_heading_rmse_deg": EnsembleMetric(
        "deg",
        "Root mean square over runs and frames of the heading error (in space: of the whole rotation's)",
        _squared_heading,
        "rms",
    ),
    "ensemble_position_rmse": EnsembleMetric(
        "m", "Root mean square over runs and frames of the position error", _squared_position, "rms"
    ),
    "ensemble_mean_heading_rmse_deg": EnsembleMetric(
        "deg", "Mean over frames of the heading's RMSE over runs", _squared_heading, "mean_of_rms"
    ),
    "ensemble_mean_position_rmse": EnsembleMetric(
        "m", "Mean over frames of the position's RMSE over runs", _squared_position, "mean_of_rms"
    ),
    "ensemble_nees_heading": EnsembleMetric(
        "1", "Mean NEES of the heading over runs and frames", _heading_nees, "mean"
    ),
    "ensemble_nees_position": EnsembleMetric(
        "1", "Mean NEES of the position over runs and frames, divided by 2", _position_nees, "mean"
    ),
    "ensemble_nees_pose": EnsembleMetric(
        "1",
        "Mean NEES of the pose in the body tangent over runs and frames, divided by 3 (6 in space)",
        _pose_nees,
        "mean",
    ),
}
