"""Whether the errors are as large as the back end's own covariances say.

NEES is e^T P^-1 e (Bar-Shalom, Li and Kirubarajan 2001, sec. 5.4.2) with e = log(T_hat^-1 T_true) and P both
in the body tangent, never after an alignment; its expectation is the dimension of e. A frame whose P is
singular (a start known exactly) has no NEES: it is skipped and ``nees_skipped_frames`` counts it. Where
the truth carries a covariance of its own (a tracking system's, a surveyor's), P is the sum of the two, for
an estimate that did not use it; a frame without truth has no NEES either.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import chdtri

from slamcmp.geometry import local
from slamcmp.metrics.matching import (
    known_poses,
    matched_landmarks,
    matched_poses,
    pose_errors,
    rotation_part,
    translation_part,
)
from slamcmp.metrics.remembered import remembered
from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Run, Trajectory

_KNOWN_EXACTLY = 1e-20
"""A variance [m² or rad²] at or below this says that the quantity is known: rounding is larger."""
_SINGULAR = 1e-12
"""Smallest eigenvalue of a correlation matrix that still counts as invertible."""

_NEES: dict[str, Any] = {
    "unit": "1",
    "needs": frozenset({"truth", "covariance"}),
    "scope": "trajectory",
    "lower_is_better": None,
}
_DIAGNOSTIC: dict[str, Any] = {
    "unit": "1",
    "needs": frozenset({"diagnostics"}),
    "scope": "run",
    "lower_is_better": None,
}


@metrics.register("pose_nees", header="pose NEES", **_NEES)
def pose_nees(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Mean NEES of the pose over the frames; expected 3 in the plane, 6 in space."""
    return _mean(nees_series(trajectory, truth))


@metrics.register("pose_nees_median", header="median pose NEES", **_NEES)
def pose_nees_median(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Median NEES of the pose over the frames; expected 2.37 in the plane, 5.35 in space."""
    values = nees_series(trajectory, truth)
    values = values[~np.isnan(values)]
    return float(np.median(values)) if values.size else math.nan


@metrics.register("position_nees", header="position NEES", **_NEES)
def position_nees(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Mean NEES of the position part; expected 2 in the plane, 3 in space."""
    return _mean(nees_series(trajectory, truth, "position"))


@metrics.register("heading_nees", header="heading NEES", **_NEES)
def heading_nees(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Mean NEES of the rotation part; expected 1 in the plane, 3 in space."""
    return _mean(nees_series(trajectory, truth, "heading"))


@metrics.register("nees_inside_95", header="frames inside 95 %", **_NEES)
def nees_inside_95(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Share of the frames whose pose NEES lies inside the two-sided 95 % chi-square band; expected 0.95."""
    values = nees_series(trajectory, truth)
    values = values[~np.isnan(values)]
    if not values.size:
        return math.nan
    low, high = chi2_band(pose_errors(trajectory, truth).shape[1])
    return float(np.mean((values >= low) & (values <= high)))


@metrics.register("nees_skipped_frames", header="frames without NEES", **_NEES)
def nees_skipped_frames(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Number of frames with truth that NEES skips because their covariance is singular or not finite."""
    return float(np.isnan(nees_series(trajectory, truth)[known_poses(trajectory, truth)[2]]).sum())


@metrics.register(
    "landmark_nees",
    unit="1",
    header="landmark NEES",
    needs=frozenset({"truth", "covariance", "landmarks"}),
    scope="run",
    lower_is_better=None,
)
def landmark_nees(run: Run, truth: GroundTruth) -> float:
    """Mean NEES over the last map's landmarks, in world axes; expected 2 in the plane, 3 in space."""
    return _mean(landmark_nees_values(run, truth))


@metrics.register(
    "joint_nees_per_dof",
    unit="1",
    header="joint NEES/dof",
    needs=frozenset({"truth", "covariance", "landmarks", "joint"}),
    scope="run",
    lower_is_better=None,
)
def joint_nees_per_dof(run: Run, truth: GroundTruth) -> float:
    """NEES of the last pose and the whole map together over its dimension; expected 1.

    The pose is the one that the map stands with: a smoother's map is that of its final solution, so the pose
    is the final trajectory's last; a filter's is its last estimate. The pose error is in the body tangent and
    stands first, the landmarks' are in world axes; landmarks the truth does not know are marginalised out.
    Not available where the run ended early.
    """
    if run.joint_covariance is None or run.landmarks is None or run.online.t.size != truth.t.size:
        return math.nan
    if not truth.known()[-1]:
        return math.nan
    estimated, true = matched_poses(run.final or run.online, truth)
    xi = local(estimated[-1], true[-1])
    in_map, in_truth = matched_landmarks(run.landmarks, truth)
    n = run.landmarks.positions.shape[1]
    offsets = truth.positions[in_truth] - run.landmarks.positions[in_map]
    error = np.concatenate([xi, offsets.ravel()])
    rows = np.concatenate(
        [np.arange(xi.size), (xi.size + n * in_map[:, None] + np.arange(n)).ravel()],
    )
    joint = run.joint_covariance[np.ix_(rows, rows)]
    if truth.P is not None:
        joint[: xi.size, : xi.size] += truth.P[-1]
    value = float(quadratic_forms(error, joint))
    return value / error.size


@metrics.register("nis_per_dof", header="NIS/dof", **_DIAGNOSTIC)
def nis_per_dof(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Total normalised innovation squared over its total degrees of freedom; expected 1."""
    nis, dof = run.diagnostics.get("nis"), run.diagnostics.get("nis_dof")
    if nis is None or dof is None:
        return math.nan
    used = np.isfinite(nis) & (dof > 0)
    total = float(dof[used].sum())
    return float(nis[used].sum()) / total if total > 0 else math.nan


@metrics.register("final_converged", header="final converged", **_DIAGNOSTIC)
def final_converged(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Whether the solution after the last frame stood still (1) or was cut short (0)."""
    return run.final_diagnostics.get("converged", math.nan)


@metrics.register("chi2_per_dof", header="χ²/dof", **_DIAGNOSTIC)
def chi2_per_dof(run: Run, truth: GroundTruth | None = None) -> float:  # noqa: ARG001
    """Chi-square of the final solution's residuals over its degrees of freedom; expected 1."""
    chi2, dof = run.final_diagnostics.get("chi2", math.nan), run.final_diagnostics.get("dof", math.nan)
    return float(chi2 / dof) if dof > 0 else math.nan


def nees_series(trajectory: Trajectory, truth: GroundTruth, part: str = "pose") -> FloatArray:
    """NEES of each frame, (K,), of the ``pose``, its ``position`` or its ``heading``; NaN where skipped."""
    return _nees_series(trajectory, truth, part)


@remembered
def _nees_series(trajectory: Trajectory, truth: GroundTruth, part: str) -> FloatArray:
    errors = pose_errors(trajectory, truth)
    if trajectory.P is None:
        return np.full(len(errors), math.nan)
    p = errors.shape[1]
    block = {"pose": slice(0, p), "position": translation_part(p), "heading": rotation_part(p)}[part]
    P = trajectory.P if truth.P is None else trajectory.P + truth.P[: len(errors)]
    return quadratic_forms(errors[:, block], P[:, block, block])


def landmark_nees_values(run: Run, truth: GroundTruth) -> FloatArray:
    """NEES of each landmark that the map and the truth share, (M,)."""
    if run.landmarks is None:
        return np.empty(0)
    in_map, in_truth = matched_landmarks(run.landmarks, truth)
    errors = truth.positions[in_truth] - run.landmarks.positions[in_map]
    return quadratic_forms(errors, run.landmarks.covariances[in_map])


def quadratic_forms(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """``e^T P^-1 e`` of (..., d) and (..., d, d); NaN where P is singular, indefinite or not finite."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    usable = np.asarray(
        np.isfinite(covariances).all(axis=(-1, -2))
        & np.isfinite(errors).all(axis=-1)
        & (variances > _KNOWN_EXACTLY).all(axis=-1)
    )
    # Metres and radians differ by orders of magnitude: only the correlation matrix tells rank from units.
    deviations = np.sqrt(np.where(usable[..., None], variances, 1.0))
    scaled = covariances / (deviations[..., :, None] * deviations[..., None, :])
    correlations = np.where(usable[..., None, None], scaled, np.eye(errors.shape[-1]))
    # Of one dimension the matrix is 1.
    usable &= errors.shape[-1] == 1 or np.linalg.eigvalsh(correlations)[..., 0] > _SINGULAR
    correlations = np.where(usable[..., None, None], correlations, np.eye(errors.shape[-1]))
    whitened = np.where(usable[..., None], errors, 0.0) / deviations
    solved = np.linalg.solve(correlations, whitened[..., None])[..., 0]
    return np.where(usable, (whitened * solved).sum(axis=-1), math.nan)


def chi2_band(dof: Any, share: float = 0.95) -> tuple[Any, Any]:
    """The two-sided band that holds ``share`` of a chi-square variable; ``dof`` may be an array."""
    tail = (1.0 - share) / 2.0
    return chdtri(dof, 1.0 - tail), chdtri(dof, tail)


def average_band(dof: Any, runs: Any, share: float = 0.95) -> tuple[Any, Any]:
    """The band for the mean of ``runs`` independent chi-square variables of ``dof`` degrees each."""
    low, high = chi2_band(np.multiply(dof, runs), share)
    return low / runs, high / runs


def _mean(values: FloatArray) -> float:
    values = values[~np.isnan(values)]
    return float(values.mean()) if values.size else math.nan
