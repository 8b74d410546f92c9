"""How far the estimated trajectory and map are from the true ones.

ATE and RPE follow Sturm et al. 2012, "A benchmark for the evaluation of RGB-D SLAM systems", eq. 1-4. A run
that ended early is scored on its finished frames; ``completion`` tells how many those are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcmp.errors import DataError
from slamcmp.geometry import inverse, rotation, translation
from slamcmp.metrics.alignment import Alignment, align_first_pose, align_points
from slamcmp.metrics.matching import heading_errors, matched_landmarks, matched_poses, rotation_angle
from slamcmp.registry import metrics
from slamcmp.types import GroundTruth, Run, Trajectory

FloatArray = NDArray[np.float64]

_TRAJECTORY = {"needs": frozenset({"truth"}), "scope": "trajectory", "lower_is_better": True}
_MAP = {"needs": frozenset({"truth", "landmarks"}), "scope": "run", "lower_is_better": True}


@metrics.register("ate", unit="m", header="ATE", **_TRAJECTORY)
def ate(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Absolute trajectory error: root-mean-square position error, not aligned."""
    return _rms(position_errors(trajectory, truth))


@metrics.register("ate_aligned", unit="m", header="ATE, SE-aligned", **_TRAJECTORY)
def ate_aligned(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Root-mean-square position error after the best rigid alignment (SE(2) or SE(3), no scale)."""
    alignment = trajectory_alignment(trajectory, truth)
    return math.nan if alignment is None else _rms(position_errors(trajectory, truth, alignment))


@metrics.register("ate_first_pose", unit="m", header="ATE, first pose aligned", **_TRAJECTORY)
def ate_first_pose(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Root-mean-square position error after making the first poses coincide."""
    alignment = align_first_pose(*matched_poses(trajectory, truth))
    return _rms(position_errors(trajectory, truth, alignment))


@metrics.register("rpe_translation", unit="m", header="RPE", **_TRAJECTORY)
def rpe_translation(trajectory: Trajectory, truth: GroundTruth, *, delta_frames: int = 1) -> float:
    """Relative pose error: root-mean-square translation error of the motion over one frame, all pairs."""
    return _rms(np.linalg.norm(translation(_relative_errors(trajectory, truth, delta_frames)), axis=-1))


@metrics.register("rpe_rotation_deg", unit="deg", header="RPE rotation", **_TRAJECTORY)
def rpe_rotation_deg(trajectory: Trajectory, truth: GroundTruth, *, delta_frames: int = 1) -> float:
    """Relative pose error: root-mean-square rotation error of the motion over one frame, all pairs."""
    return math.degrees(_rms(rotation_angle(rotation(_relative_errors(trajectory, truth, delta_frames)))))


@metrics.register("heading_rmse_deg", unit="deg", header="heading RMSE", **_TRAJECTORY)
def heading_rmse_deg(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Root-mean-square heading error (SE(3): angle of the whole rotation error), not aligned."""
    return math.degrees(_rms(heading_errors(trajectory, truth)))


@metrics.register("max_error", unit="m", header="largest error", **_TRAJECTORY)
def max_error(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Largest position error of any frame, not aligned."""
    errors = position_errors(trajectory, truth)
    return float(errors.max()) if errors.size else math.nan


@metrics.register("last_pose_error", unit="m", header="error of last pose", **_TRAJECTORY)
def last_pose_error(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Position error at the log's last frame, not aligned; not available where the run ended early."""
    errors = position_errors(trajectory, truth)
    return float(errors[-1]) if 0 < errors.size == truth.t.size else math.nan


@metrics.register("landmark_rmse", unit="m", header="landmark RMSE", **_MAP)
def landmark_rmse(run: Run, truth: GroundTruth) -> float:
    """Root-mean-square position error of the last map's landmarks, not aligned."""
    return _rms(landmark_errors(run, truth))


@metrics.register("landmark_rmse_aligned", unit="m", header="landmark RMSE, SE-aligned", **_MAP)
def landmark_rmse_aligned(run: Run, truth: GroundTruth) -> float:
    """Root-mean-square landmark error under the rigid alignment of the trajectory (final, else online)."""
    alignment = trajectory_alignment(run.final or run.online, truth)
    return math.nan if alignment is None else _rms(landmark_errors(run, truth, alignment))


def position_errors(
    trajectory: Trajectory, truth: GroundTruth, alignment: Alignment | None = None
) -> FloatArray:
    """Distances [m] between estimated and true positions, (K,)."""
    estimated, true = matched_poses(trajectory, truth)
    positions = translation(estimated) if alignment is None else alignment.points(translation(estimated))
    distances: FloatArray = np.linalg.norm(positions - translation(true), axis=-1)
    return distances


def landmark_errors(run: Run, truth: GroundTruth, alignment: Alignment | None = None) -> FloatArray:
    """Distances [m] of the landmarks that the map and the truth share, (M,)."""
    if run.landmarks is None:
        return np.empty(0)
    in_map, in_truth = matched_landmarks(run.landmarks, truth)
    positions = run.landmarks.positions[in_map]
    if alignment is not None:
        positions = alignment.points(positions)
    distances: FloatArray = np.linalg.norm(positions - truth.positions[in_truth], axis=-1)
    return distances


def trajectory_alignment(trajectory: Trajectory, truth: GroundTruth) -> Alignment | None:
    """The rigid alignment of the positions, or None where they do not determine one."""
    estimated, true = matched_poses(trajectory, truth)
    if len(true) < 2:
        return None
    try:
        return align_points(translation(estimated), translation(true))
    except DataError:
        return None


def _relative_errors(trajectory: Trajectory, truth: GroundTruth, delta_frames: int) -> FloatArray:
    estimated, true = matched_poses(trajectory, truth)
    moved = inverse(estimated[:-delta_frames]) @ estimated[delta_frames:]
    moved_true = inverse(true[:-delta_frames]) @ true[delta_frames:]
    return inverse(moved_true) @ moved


def _rms(errors: FloatArray) -> float:
    return math.sqrt(float(np.mean(errors**2))) if errors.size else math.nan
