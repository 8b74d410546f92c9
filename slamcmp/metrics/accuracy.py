"""How far the estimated trajectory and map are from the true ones.

ATE and RPE over a frame follow Sturm et al. 2012, "A benchmark for the evaluation of RGB-D SLAM systems", eq.
1-4; RPE per metre follows Geiger et al. 2012 (see :func:`segment_errors`). A run that ended early is
scored on its finished frames; ``completion`` tells how many those are. A truth with gaps scores the frames it
knows, and motion between two of them with no gap in between; ``truth_share`` tells how many those are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slamcmp.errors import DataError
from slamcmp.geometry import inverse, rotation, translation
from slamcmp.metrics.alignment import Alignment, align_first_pose, align_points
from slamcmp.metrics.matching import (
    heading_errors,
    known_poses,
    matched_landmarks,
    matched_poses,
    rotation_angle,
)
from slamcmp.metrics.remembered import remembered
from slamcmp.registry import metrics
from slamcmp.types import FloatArray, GroundTruth, Run, Trajectory

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
    """Root-mean-square position error after making the first poses coincide whose truth is known."""
    estimated, true, _ = known_poses(trajectory, truth)
    if not len(true):
        return math.nan
    alignment = align_first_pose(estimated, true)
    return _rms(position_errors(trajectory, truth, alignment))


@metrics.register("rpe_translation", unit="m", header="RPE", **_TRAJECTORY)
def rpe_translation(trajectory: Trajectory, truth: GroundTruth, *, delta_frames: int = 1) -> float:
    """Relative pose error: root-mean-square translation error of the motion over one frame, all pairs."""
    return _rms(np.linalg.norm(translation(_relative_errors(trajectory, truth, delta_frames)), axis=-1))


@metrics.register("rpe_rotation_deg", unit="deg", header="RPE rotation", **_TRAJECTORY)
def rpe_rotation_deg(trajectory: Trajectory, truth: GroundTruth, *, delta_frames: int = 1) -> float:
    """Relative pose error: root-mean-square rotation error of the motion over one frame, all pairs."""
    return math.degrees(_rms(rotation_angle(rotation(_relative_errors(trajectory, truth, delta_frames)))))


@metrics.register("rpe_per_metre", unit="%", header="RPE per metre", **_TRAJECTORY)
def rpe_per_metre(
    trajectory: Trajectory, truth: GroundTruth, *, lengths_m: Sequence[float] | None = None
) -> float:
    """Mean translation error of the motion over segments of the true path, in percent of their length."""
    errors, driven = segment_errors(trajectory, truth, lengths_m)
    if not driven.size:
        return math.nan
    return 100.0 * float(np.mean(np.linalg.norm(translation(errors), axis=-1) / driven))


@metrics.register("rpe_rotation_deg_per_m", unit="deg/m", header="RPE rotation per metre", **_TRAJECTORY)
def rpe_rotation_deg_per_m(
    trajectory: Trajectory, truth: GroundTruth, *, lengths_m: Sequence[float] | None = None
) -> float:
    """Mean rotation error of the motion over segments of the true path, per metre of their length."""
    errors, driven = segment_errors(trajectory, truth, lengths_m)
    return (
        math.degrees(float(np.mean(rotation_angle(rotation(errors)) / driven))) if driven.size else math.nan
    )


@metrics.register("heading_rmse_deg", unit="deg", header="heading RMSE", **_TRAJECTORY)
def heading_rmse_deg(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Root-mean-square heading error (SE(3): angle of the whole rotation error), not aligned."""
    return math.degrees(_rms(heading_errors(trajectory, truth)))


@metrics.register("max_error", unit="m", header="largest error", **_TRAJECTORY)
def max_error(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Largest position error of any frame, not aligned."""
    errors = _of_known(position_errors(trajectory, truth))
    return float(errors.max()) if errors.size else math.nan


@metrics.register("last_pose_error", unit="m", header="error of last pose", **_TRAJECTORY)
def last_pose_error(trajectory: Trajectory, truth: GroundTruth) -> float:
    """Position error at the log's last frame, not aligned; not available where run or truth ended early."""
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


@metrics.register(
    "truth_share",
    unit="1",
    header="share with truth",
    needs=frozenset({"truth"}),
    scope="run",
    lower_is_better=None,
)
def truth_share(run: Run, truth: GroundTruth) -> float:
    """Share of the finished frames whose true pose is known: all scores are of these."""
    known = truth.known()[: run.online.t.size]
    return float(known.mean()) if known.size else math.nan


def position_errors(
    trajectory: Trajectory, truth: GroundTruth, alignment: Alignment | None = None
) -> FloatArray:
    """Distances [m] between estimated and true positions, (K,); NaN where the truth has a gap."""
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
    estimated, true, _ = known_poses(trajectory, truth)
    if len(true) < 2:
        return None
    try:
        return align_points(translation(estimated), translation(true))
    except DataError:
        return None


def segment_errors(
    trajectory: Trajectory, truth: GroundTruth, lengths_m: Sequence[float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Errors (S, n+1, n+1) of the motion over segments of the true path, and the segments' lengths [m], (S,).

    After the odometry benchmark of Geiger, Lenz and Urtasun 2012, "Are we ready for autonomous driving?",
    sec. 3: from every frame one segment of each length, to the first frame that is so far along the true
    path. There the lengths are 100 to 800 m of a drive of a kilometre or more; here 10 % to 80 % of the whole
    true path unless given, the same for every run on the log. Errors are taken over the length that was
    driven, not the nominal one, so that the distance between frames does not matter; every frame starts
    segments, not every tenth. No segment fits: empty.
    """
    return _segment_errors(trajectory, truth, None if lengths_m is None else tuple(lengths_m))


@remembered
def _segment_errors(
    trajectory: Trajectory, truth: GroundTruth, lengths_m: tuple[float, ...] | None
) -> tuple[FloatArray, FloatArray]:
    estimated, true, rows = known_poses(trajectory, truth)
    whole = translation(truth.T_world_body[truth.known()])
    if not len(whole):
        return truth.T_world_body[:0], np.empty(0)
    steps = np.linalg.norm(np.diff(whole, axis=0), axis=-1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    lengths = path[-1] * np.arange(1, 9) / 10.0 if lengths_m is None else np.asarray(lengths_m, dtype=float)
    path = path[: len(true)]
    starts = np.tile(np.arange(len(true)), lengths.size)
    # A hair less: sums of equal steps fall on either side of their product.
    goals = path[starts] + np.repeat(lengths, len(true)) * (1.0 - 1e-9)
    ends = np.searchsorted(path, goals)
    fits = (ends < len(true)) & (ends > starts)
    starts, ends = starts[fits], ends[fits]
    # How far the robot went in a gap is not known.
    closed = rows[ends] - rows[starts] == ends - starts
    starts, ends = starts[closed], ends[closed]
    moved, moved_true = (inverse(poses[starts]) @ poses[ends] for poses in (estimated, true))
    return inverse(moved_true) @ moved, path[ends] - path[starts]


@remembered
def _relative_errors(trajectory: Trajectory, truth: GroundTruth, delta_frames: int) -> FloatArray:
    estimated, true = matched_poses(trajectory, truth)
    known = truth.known()[: len(true)]
    starts = np.flatnonzero(known[:-delta_frames] & known[delta_frames:])
    moved = inverse(estimated[starts]) @ estimated[starts + delta_frames]
    moved_true = inverse(true[starts]) @ true[starts + delta_frames]
    return inverse(moved_true) @ moved


def _of_known(errors: FloatArray) -> FloatArray:
    """Those of frames whose truth is known."""
    return errors[~np.isnan(errors)]


def _rms(errors: FloatArray) -> float:
    errors = _of_known(errors)
    return math.sqrt(float(np.mean(errors**2))) if errors.size else math.nan
