"""Pair a trajectory with the truth frame by frame, and the errors between the two."""

from __future__ import annotations

import numpy as np

from slamcmp.errors import DataError
from slamcmp.geometry import local, rotation, so3_log, wrap
from slamcmp.metrics.remembered import remembered
from slamcmp.types import FloatArray, GroundTruth, IntArray, Landmarks, Trajectory


def matched_poses(trajectory: Trajectory, truth: GroundTruth) -> tuple[FloatArray, FloatArray]:
    """Estimated and true poses of the finished frames, both (K, n+1, n+1); NaN where the truth has a gap.

    A trajectory that ended early is paired with the truth's first frames.

    Raises:
        DataError: the time stamps or the dimensions of the two differ.
    """
    frames = trajectory.t.size
    if frames > truth.t.size or not np.allclose(trajectory.t, truth.t[:frames], rtol=0.0, atol=1e-9):
        raise DataError(
            f"trajectory of {frames} frames and truth of {truth.t.size} frames do not share their time "
            "stamps; both must come from the same log"
        )
    if trajectory.T_world_body.shape[1:] != truth.T_world_body.shape[1:]:
        raise DataError(
            f"trajectory poses {trajectory.T_world_body.shape[1:]} and true poses "
            f"{truth.T_world_body.shape[1:]} are not of the same space"
        )
    return trajectory.T_world_body, truth.T_world_body[:frames]


def known_poses(trajectory: Trajectory, truth: GroundTruth) -> tuple[FloatArray, FloatArray, IntArray]:
    """Estimated and true poses (M, n+1, n+1) of the finished frames with known truth, and which those are.

    Raises:
        DataError: see :func:`matched_poses`.
    """
    estimated, true = matched_poses(trajectory, truth)
    rows = np.flatnonzero(truth.known()[: len(true)])
    return estimated[rows], true[rows], rows


def pose_errors(trajectory: Trajectory, truth: GroundTruth) -> FloatArray:
    """``log(T_hat⁻¹ T_true)`` in the body tangent, (K, p); NaN where the truth is not known."""
    return _pose_errors(trajectory, truth, None)


@remembered
def _pose_errors(trajectory: Trajectory, truth: GroundTruth, how: None) -> FloatArray:  # noqa: ARG001
    estimated, true, rows = known_poses(trajectory, truth)
    errors = np.full((trajectory.t.size, pose_dimension(truth.T_world_body)), np.nan)
    errors[rows] = local(estimated, true)
    return errors


def pose_dimension(T: FloatArray) -> int:
    """Of the tangent space of poses (..., n+1, n+1): 3 in the plane, 6 in space."""
    return 3 if T.shape[-1] == 3 else 6


def rotation_angle(R: FloatArray) -> FloatArray:
    """Angles [rad] in [0, pi] of rotation matrices (..., n, n)."""
    if R.shape[-1] == 2:
        planar: FloatArray = np.abs(wrap(np.arctan2(R[..., 1, 0], R[..., 0, 0])))
        return planar
    spatial: FloatArray = np.linalg.norm(so3_log(R), axis=-1)
    return spatial


def heading_errors(trajectory: Trajectory, truth: GroundTruth) -> FloatArray:
    """Angle [rad] between estimated and true orientation, (K,), NaN where that is not known.

    In SE(3) of the whole rotation.
    """
    estimated, true, rows = known_poses(trajectory, truth)
    errors = np.full(trajectory.t.size, np.nan)
    errors[rows] = rotation_angle(np.swapaxes(rotation(estimated), -1, -2) @ rotation(true))
    return errors


def matched_landmarks(landmarks: Landmarks, truth: GroundTruth) -> tuple[IntArray, IntArray]:
    """Indices into the map and into the truth of the landmarks that both hold, each (M,)."""
    _, in_map, in_truth = np.intersect1d(landmarks.ids, truth.ids, assume_unique=True, return_indices=True)
    known = np.isfinite(truth.positions[in_truth]).all(axis=1)
    return in_map[known], in_truth[known]


def translation_part(p: int) -> slice:
    """Where the translation stands in a tangent vector of dimension p (3 or 6)."""
    return slice(0, 2) if p == 3 else slice(3, 6)


def rotation_part(p: int) -> slice:
    """Where the rotation stands in a tangent vector of dimension p (3 or 6)."""
    return slice(2, 3) if p == 3 else slice(0, 3)
