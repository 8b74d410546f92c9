"""A run as rows of the results' tables: its scores, its frames, its landmarks."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.errors import DataError
from slamcmp.geometry import heading, rotation, translation
from slamcmp.metrics.accuracy import position_errors
from slamcmp.metrics.consistency import nees_series, quadratic_forms
from slamcmp.metrics.gating import gate_counts
from slamcmp.metrics.matching import (
    heading_errors,
    matched_landmarks,
    pose_dimension,
    pose_errors,
    translation_part,
)
from slamcmp.registry import Plugin, metrics
from slamcmp.types import FloatArray, GroundTruth, Run, Trajectory


@dataclass(frozen=True)
class MetricColumn:
    """What a metric column of the trials table holds."""

    metric: str
    unit: str
    """``"1"`` for a pure number."""
    lower_is_better: bool | None
    """None where the value has a target (NEES) or no direction."""
    description: str
    trajectory: str
    """``"online"``, ``"final"``, or ``""`` for a metric of the whole run."""
    header: str
    """A short heading without the unit."""


def metric_columns() -> dict[str, MetricColumn]:
    """Every metric column of the trials table, in the registry's order."""
    return {
        f"{which}_{plugin.name}" if which else plugin.name: MetricColumn(
            plugin.name,
            plugin.traits["unit"],
            plugin.traits["lower_is_better"],
            plugin.summary,
            which,
            plugin.traits.get("header", plugin.name),
        )
        for plugin in metrics
        for which in _trajectories(plugin)
    }


def score_run(run: Run, truth: GroundTruth | None, *, reference: bool = False) -> dict[str, float]:
    """Every metric column of a run; NaN where a metric's needs are not met.

    With ``reference`` the "truth" is another back end's solution: an error against it is a difference, and
    no covariance can be judged by it.
    """
    scores: dict[str, float] = {}
    for plugin in metrics:
        for which in _trajectories(plugin):
            if which:
                trajectory = run.online if which == "online" else run.final
                met = _trajectory_needs_met(plugin, trajectory, truth, reference)
                scores[f"{which}_{plugin.name}"] = _value(plugin, trajectory, truth) if met else math.nan
            else:
                met = _run_needs_met(plugin, run, truth, reference)
                scores[plugin.name] = _value(plugin, run, truth) if met else math.nan
    return scores


def frame_table(
    run: Run, truth: GroundTruth | None, *, reference: bool = False, taken: Collection[str] = ()
) -> pd.DataFrame:
    """One row per finished frame: poses, errors in the body tangent with their sigmas, NEES, times.

    Positions in m in the world, headings in rad, times in s. The columns of the final trajectory are there
    only where the run has one; NEES is NaN against a ``reference`` that is not the truth. A diagnostic that
    is called like a column, or like one of the names that are ``taken``, gets ``_diagnostic`` appended.
    """
    frames = run.online.t.size
    columns: dict[str, Any] = {"k": np.arange(frames), "t": run.online.t}
    n = run.online.T_world_body.shape[-1] - 1
    true = np.full((frames, n + 1, n + 1), math.nan) if truth is None else truth.T_world_body[:frames]
    columns |= _pose_columns("true", true)
    trajectories = {"online": run.online}
    if run.final is not None and run.final.t.size == frames:
        trajectories["final"] = run.final
    for which, trajectory in trajectories.items():
        columns |= _trajectory_columns(which, trajectory, truth, reference)
    columns |= {"update_s": run.update_s, "estimate_s": run.estimate_s}
    if run.kept_observations is not None:
        columns |= gate_counts(run, truth)
    for name, series in run.diagnostics.items():
        while name in columns or name in taken:
            name += "_diagnostic"
        columns[name] = series
    return pd.DataFrame(columns)


def landmark_table(run: Run, truth: GroundTruth | None, *, reference: bool = False) -> pd.DataFrame:
    """One row per landmark of the last map: position, covariance in world axes, error and NEES."""
    names = "xyz"[: run.online.T_world_body.shape[-1] - 1]
    count = 0 if run.landmarks is None else run.landmarks.ids.size
    positions = np.empty((0, len(names))) if run.landmarks is None else run.landmarks.positions
    covariances = np.empty((0, 2, 2)) if run.landmarks is None else run.landmarks.covariances
    true = np.full(positions.shape, math.nan)
    nees = np.full(count, math.nan)
    if run.landmarks is not None and truth is not None:
        in_map, in_truth = matched_landmarks(run.landmarks, truth)
        true[in_map] = truth.positions[in_truth]
        if not reference:
            nees = quadratic_forms(true - positions, covariances)
    columns: dict[str, Any] = {"id": np.empty(0, np.int64) if run.landmarks is None else run.landmarks.ids}
    columns |= {name: positions[:, axis] for axis, name in enumerate(names)}
    columns |= _covariance_columns("P", covariances)
    columns |= {f"true_{name}": true[:, axis] for axis, name in enumerate(names)}
    columns |= {"error_m": np.linalg.norm(true - positions, axis=1), "nees": nees}
    return pd.DataFrame(columns)


def reference_truth(run: Run) -> GroundTruth:
    """A run's final trajectory and map in the role of the truth, for logs that have none.

    Raises:
        DataError: the run has no complete final trajectory.
    """
    if run.final is None or run.status != "ok":
        raise DataError(
            f"reference {run.back_end!r} has no final trajectory (status {run.status}); "
            "a smoother that finished is needed"
        )
    n = run.final.T_world_body.shape[-1] - 1
    no_ids, no_positions = np.empty(0, np.int64), np.empty((0, n))
    return GroundTruth(
        t=run.final.t,
        T_world_body=run.final.T_world_body,
        ids=no_ids if run.landmarks is None else run.landmarks.ids,
        positions=no_positions if run.landmarks is None else run.landmarks.positions,
    )


def _trajectories(plugin: Plugin) -> tuple[str, ...]:
    return ("online", "final") if plugin.traits["scope"] == "trajectory" else ("",)


def _trajectory_needs_met(
    plugin: Plugin, trajectory: Trajectory | None, truth: GroundTruth | None, reference: bool
) -> bool:
    needs = plugin.traits["needs"]
    if trajectory is None or not trajectory.t.size or not np.isfinite(trajectory.T_world_body).all():
        return False
    if "covariance" in needs and trajectory.P is None:
        return False
    return _truth_fits(needs, truth, reference)


def _run_needs_met(plugin: Plugin, run: Run, truth: GroundTruth | None, reference: bool) -> bool:
    needs = plugin.traits["needs"]
    if "landmarks" in needs and (run.landmarks is None or not np.isfinite(run.landmarks.positions).all()):
        return False
    if "joint" in needs and run.joint_covariance is None:
        return False
    if "truth" in needs and not np.isfinite((run.final or run.online).T_world_body).all():
        return False
    return _truth_fits(needs, truth, reference)


def _truth_fits(needs: frozenset[str], truth: GroundTruth | None, reference: bool) -> bool:
    return "truth" not in needs or (truth is not None and not (reference and "covariance" in needs))


def _value(plugin: Plugin, subject: Any, truth: GroundTruth | None) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(plugin.target(subject, truth))


def _pose_columns(prefix: str, poses: FloatArray) -> dict[str, FloatArray]:
    positions = translation(poses)
    names = "xyz"[: positions.shape[1]]
    columns = {f"{prefix}_{name}": positions[:, axis] for axis, name in enumerate(names)}
    return columns | {f"{prefix}_heading_rad": heading(poses)}


def _trajectory_columns(
    which: str, trajectory: Trajectory, truth: GroundTruth | None, reference: bool
) -> dict[str, FloatArray]:
    poses = trajectory.T_world_body
    frames, p = trajectory.t.size, pose_dimension(poses)
    nothing = np.full(frames, math.nan)
    columns = _pose_columns(which, poses)
    known = truth is not None and bool(np.isfinite(poses).all())
    errors = pose_errors(trajectory, truth) if known and truth is not None else np.full((frames, p), math.nan)
    columns |= {f"{which}_err_{i}": errors[:, i] for i in range(p)}
    covariances = np.full((frames, p, p), math.nan) if trajectory.P is None else trajectory.P
    with np.errstate(invalid="ignore"):
        deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    columns |= {f"{which}_sigma_{i}": deviations[:, i] for i in range(p)}
    if known and truth is not None:
        columns[f"{which}_position_error_m"] = position_errors(trajectory, truth)
        columns[f"{which}_heading_error_deg"] = np.degrees(heading_errors(trajectory, truth))
        columns[f"{which}_nees"] = nothing if reference else nees_series(trajectory, truth)
    else:
        columns |= {f"{which}_{name}": nothing for name in ("position_error_m", "heading_error_deg", "nees")}
    part = translation_part(p)
    R = rotation(poses)
    return columns | _covariance_columns(f"{which}_P", R @ covariances[:, part, part] @ np.swapaxes(R, 1, 2))


def _covariance_columns(prefix: str, covariances: FloatArray) -> dict[str, FloatArray]:
    return {
        f"{prefix}_xx": covariances[:, 0, 0],
        f"{prefix}_xy": covariances[:, 0, 1],
        f"{prefix}_yy": covariances[:, 1, 1],
    }
