"""Accuracy metrics against values derived by hand and against an independent tool."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from slamcmp.errors import DataError
from slamcmp.geometry import exp, pose, se2
from slamcmp.metrics import accuracy
from slamcmp.metrics.alignment import align_first_pose, align_points


def test_errors_of_a_straight_line(truth_of, trajectory_of):
    truth = truth_of(se2([0, 1, 2], 0, 0))
    trajectory = trajectory_of(se2([0, 1, 2], [0, 0.3, 0.4], 0))
    # Position errors 0, 0.3 and 0.4 m; the steps are off by 0.3 and 0.1 m.
    assert accuracy.ate(trajectory, truth) == pytest.approx(math.sqrt(0.25 / 3), abs=1e-15)
    assert accuracy.max_error(trajectory, truth) == pytest.approx(0.4, abs=1e-15)
    assert accuracy.last_pose_error(trajectory, truth) == pytest.approx(0.4, abs=1e-15)
    assert accuracy.rpe_translation(trajectory, truth) == pytest.approx(math.sqrt(0.05), abs=1e-15)
    assert accuracy.rpe_translation(trajectory, truth, delta_frames=2) == pytest.approx(0.4, abs=1e-15)
    assert accuracy.rpe_rotation_deg(trajectory, truth) == 0


def test_error_per_metre_of_a_wheel_that_is_measured_too_small(truth_of, trajectory_of):
    """Odometry that reports 2 % too much is off by 2 % on every segment, however far apart frames are."""
    x = np.cumsum(np.concatenate([[0.0], np.random.default_rng(0).uniform(0.1, 0.9, 60)]))
    truth, trajectory = truth_of(se2(x, 0, 0)), trajectory_of(se2(1.02 * x, 0, 0))
    assert accuracy.rpe_per_metre(trajectory, truth) == pytest.approx(2.0, rel=1e-10)
    assert accuracy.rpe_per_metre(trajectory, truth, lengths_m=[3.0]) == pytest.approx(2.0, rel=1e-10)
    assert accuracy.rpe_rotation_deg_per_m(trajectory, truth) == 0


def test_error_per_metre_of_a_drifting_gyroscope(truth_of, trajectory_of):
    """Half a degree too much a metre; where the world lies and is turned does not matter."""
    t = np.arange(41.0)
    drift = math.radians(0.5)
    truth = truth_of(se2(t, 0, 0))
    arc = exp(np.stack([t, 0 * t, drift * t], axis=1))
    for moved in (np.eye(3), se2(30.0, -4.0, 2.0)):
        trajectory = trajectory_of(moved @ arc)
        assert accuracy.rpe_rotation_deg_per_m(trajectory, truth) == pytest.approx(0.5, rel=1e-10)
        # A segment of L metres is an arc whose end is off by the chord's difference to (L, 0).
        chord = exp(np.array([8.0, 0.0, 8 * drift]))[:2, 2] - [8.0, 0.0]
        found = accuracy.rpe_per_metre(trajectory, truth, lengths_m=[8.0])
        assert found == pytest.approx(100 * np.linalg.norm(chord) / 8.0, rel=1e-10)


def test_segments_begin_at_every_frame_and_end_on_the_true_path(truth_of, trajectory_of):
    """Ten metres: segments of 1 to 8 m from 10, 9, … 3 frames; of a run that ended at 4 m, those that fit."""
    truth = truth_of(se2(np.arange(11.0), 0, 0))
    _, driven = accuracy.segment_errors(trajectory_of(truth.T_world_body), truth)
    lengths, counts = np.unique(driven, return_counts=True)
    assert lengths.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert counts.tolist() == [10, 9, 8, 7, 6, 5, 4, 3]
    _, driven = accuracy.segment_errors(trajectory_of(truth.T_world_body[:5]), truth)
    assert sorted(driven.tolist()) == [1, 1, 1, 1, 2, 2, 2, 3, 3, 4]
    standing = truth_of(se2(np.zeros(5), 0, 0))
    assert math.isnan(accuracy.rpe_per_metre(trajectory_of(standing.T_world_body), standing))
    assert math.isnan(accuracy.rpe_rotation_deg_per_m(trajectory_of(standing.T_world_body), standing))


def test_heading_error_wraps(truth_of, trajectory_of):
    truth = truth_of(se2(0, 0, [math.pi - 0.05, 0.0]))
    trajectory = trajectory_of(se2(0, 0, [-math.pi + 0.05, 0.2]))
    # 0.1 rad across the cut and 0.2 rad; the one motion is off by 0.1 rad.
    expected = math.degrees(math.sqrt((0.01 + 0.04) / 2))
    assert accuracy.heading_rmse_deg(trajectory, truth) == pytest.approx(expected, abs=1e-12)
    assert accuracy.rpe_rotation_deg(trajectory, truth) == pytest.approx(math.degrees(0.1), abs=1e-12)


def test_heading_error_in_space_is_the_angle_of_the_whole_rotation(truth_of, trajectory_of):
    truth = truth_of(np.eye(4)[None])
    # Rotation vector (0.3, 0, 0.4): 0.5 rad.
    trajectory = trajectory_of(exp(np.array([[0.3, 0.0, 0.4, 0.0, 0.0, 0.0]])))
    assert accuracy.heading_rmse_deg(trajectory, truth) == pytest.approx(math.degrees(0.5), abs=1e-12)


def test_alignment_undoes_a_rigid_motion_but_not_a_scale(truth_of, trajectory_of):
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    truth = truth_of(se2(corners[:, 0], corners[:, 1], 0))
    moved = se2(3.0, -2.0, 2.0) @ truth.T_world_body
    assert accuracy.ate_aligned(trajectory_of(moved), truth) == pytest.approx(0, abs=1e-14)
    # Corners 10 % too far out: the best rigid alignment leaves 0.1 m along each axis.
    wide = trajectory_of(se2(1.1 * corners[:, 0], 1.1 * corners[:, 1], 0))
    assert accuracy.ate_aligned(wide, truth) == pytest.approx(0.1 * math.sqrt(2), abs=1e-14)
    with_scale = align_points(1.1 * corners, corners, with_scale=True)
    assert with_scale.scale == pytest.approx(1 / 1.1, abs=1e-14)
    np.testing.assert_allclose(with_scale.points(1.1 * corners), corners, atol=1e-14)


def test_alignment_never_mirrors():
    points = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]])
    alignment = align_points(points * [1, -1], points)
    assert np.linalg.det(alignment.T_true_estimated[:2, :2]) == pytest.approx(1.0, abs=1e-14)


def test_alignment_refuses_points_that_leave_the_rotation_open(truth_of, trajectory_of):
    with pytest.raises(DataError, match="leave the rotation open"):
        align_points(np.zeros((4, 2)), np.zeros((4, 2)))
    line = np.outer(np.arange(4.0), [1.0, 2.0, 3.0])
    with pytest.raises(DataError, match="leave the rotation open"):
        align_points(line, line)
    standing = se2(np.zeros(3), 0, 0)
    assert math.isnan(accuracy.ate_aligned(trajectory_of(standing), truth_of(standing)))


def test_first_pose_alignment_removes_a_wrong_start(truth_of, trajectory_of):
    truth = truth_of(se2([0, 1, 2], 0, 0))
    # Starts at (5, 5) looking north and drives the same way: as good as the truth once turned back.
    north = se2(5.0, [5, 6, 7], math.pi / 2)
    assert accuracy.ate_first_pose(trajectory_of(north), truth) == pytest.approx(0, abs=1e-14)
    # (0.5 m, 0) to the left only in the last frame.
    north = se2([5.0, 5.0, 4.5], [5, 6, 7], math.pi / 2)
    expected = math.sqrt(0.25 / 3)
    assert accuracy.ate_first_pose(trajectory_of(north), truth) == pytest.approx(expected, abs=1e-14)


def test_partial_run_is_scored_on_its_frames_but_has_no_last_pose(truth_of, trajectory_of):
    truth = truth_of(se2([0, 1, 2, 3], 0, 0))
    trajectory = trajectory_of(se2([0, 1], [0.0, 0.2], 0))
    assert accuracy.ate(trajectory, truth) == pytest.approx(math.sqrt(0.02), abs=1e-15)
    assert math.isnan(accuracy.last_pose_error(trajectory, truth))


def test_other_time_stamps_are_refused(truth_of, trajectory_of):
    with pytest.raises(DataError, match="do not share their time stamps"):
        accuracy.ate(trajectory_of(se2([0, 1, 2], 0, 0)), truth_of(se2([0, 1], 0, 0)))


@pytest.mark.parametrize("shift_s", [2e-9, 1e-3, -0.5, 1.0])
def test_stamps_that_differ_are_refused(shift_s, truth_of, trajectory_of):
    truth = truth_of(se2([0, 1, 2], 0, 0))
    late = dataclasses.replace(trajectory_of(truth.T_world_body), t=truth.t + shift_s)
    with pytest.raises(DataError, match="do not share their time stamps"):
        accuracy.ate(late, truth)


def test_poses_of_another_space_are_refused(truth_of, trajectory_of):
    with pytest.raises(DataError, match="not of the same space"):
        accuracy.ate(trajectory_of(np.tile(np.eye(4), (3, 1, 1))), truth_of(np.tile(np.eye(3), (3, 1, 1))))


def test_errors_in_space_have_three_axes(truth_of, trajectory_of):
    truth = truth_of(np.broadcast_to(np.eye(4), (2, 4, 4)))
    moved = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    moved[:, :3, 3] = [2.0, 3.0, 6.0]
    assert accuracy.ate(trajectory_of(moved), truth) == pytest.approx(7.0, abs=1e-15)
    assert accuracy.max_error(trajectory_of(moved), truth) == pytest.approx(7.0, abs=1e-15)


def test_every_error_tells_its_place_from_every_other(truth_of, trajectory_of):
    """Errors 3, 0, 1 and 2 m: root mean square, largest and last are three numbers, and none is the first."""
    truth = truth_of(se2([0, 1, 2, 3], 0, 0))
    trajectory = trajectory_of(se2([0, 1, 2, 3], [3.0, 0.0, 1.0, 2.0], 0))
    assert accuracy.ate(trajectory, truth) == pytest.approx(math.sqrt(14 / 4), abs=1e-15)
    assert accuracy.max_error(trajectory, truth) == 3.0
    assert accuracy.last_pose_error(trajectory, truth) == 2.0
    assert accuracy.ate_aligned(trajectory, truth) < 1.2 < accuracy.ate(trajectory, truth)
    # With the first pose's 3 m taken off: 0, 3, 2, 1.
    assert accuracy.ate_first_pose(trajectory, truth) == pytest.approx(math.sqrt(14 / 4), abs=1e-15)
    behind = trajectory_of(se2([0, 1, 2, 3], [1.0, 1.0, 1.0, 4.0], 0))
    assert accuracy.ate_first_pose(behind, truth) == pytest.approx(1.5, abs=1e-15)
    assert accuracy.ate_aligned(behind, truth) < 1.0


def test_landmarks_are_paired_by_their_ids(truth_of, run_of):
    """The truth's order is its own, and it knows landmarks that are not in the map."""
    poses = se2([0, 1], 0, 0)
    truth = truth_of(poses, [[50.0, 50.0], [4.0, 0.0], [0.0, 3.0]])
    truth = dataclasses.replace(truth, ids=np.array([7, 42, 5]))
    run = run_of(poses, positions=[[0.0, 3.5], [4.0, 1.0]], ids=[5, 42])
    assert accuracy.landmark_rmse(run, truth) == pytest.approx(math.sqrt((0.25 + 1.0) / 2), abs=1e-15)
    assert accuracy.landmark_rmse_aligned(run, truth) == pytest.approx(
        accuracy.landmark_rmse(run, truth), abs=1e-12
    )


def test_landmark_rmse_raw_and_with_the_trajectory_s_alignment(truth_of, run_of):
    poses = se2([0, 1, 2], [0, 1, 0], 0)
    positions = np.array([[0.0, 3.0], [4.0, 0.0]])
    truth = truth_of(poses, positions)
    # Everything 1 m too far east; landmark 99 is not in the truth and does not count.
    run = run_of(
        se2([1, 2, 3], [0, 1, 0], 0), positions=[[9.0, 9.0], [1.0, 3.0], [5.0, 0.0]], ids=[99, 10, 11]
    )
    assert accuracy.landmark_rmse(run, truth) == pytest.approx(1.0, abs=1e-14)
    assert accuracy.landmark_rmse_aligned(run, truth) == pytest.approx(0.0, abs=1e-14)


def reference_poses(space_dim: int) -> tuple[np.ndarray, np.ndarray]:
    """True and estimated poses of 50 frames, as the independent tool was given them."""
    k = np.arange(50)
    a = 0.1 * k
    b = a + 0.02 * np.sin(0.3 * k) + 0.3
    x, y, z = 5 * np.cos(a), 3 * np.sin(a), 0.5 * np.sin(2 * a)
    dx, dy, dz = 0.1 * np.sin(0.7 * k) + 1, 0.05 * np.cos(1.3 * k) - 2, 0.03 * np.sin(1.1 * k) + 0.4
    if space_dim == 2:
        return se2(x, y, a), se2(x + dx, y + dy, b)

    def turn(yaw, pitch):
        c, s, u, v = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
        zero = np.zeros_like(yaw)
        rows = [[c * u, -s, c * v], [s * u, c, s * v], [-v, zero, u]]
        return np.moveaxis(np.array(rows), -1, 0)

    pitch = 0.2 * np.sin(a)
    true = pose(turn(a, pitch), np.stack([x, y, z], -1))
    estimated = pose(turn(b, pitch + 0.01 * np.cos(0.9 * k)), np.stack([x + dx, y + dy, z + dz], -1))
    return true, estimated


# Printed by evo 1.38.1 (run by hand, apart from this project): APE of the translation part without
# alignment, with align, with align and correct_scale, with align_origin; APE of the rotation angle; RPE with
# all pairs, delta 1 and 7 frames. Rotation angles in degrees.
INDEPENDENT = {
    2: {
        "ape_raw": 2.2387912236947227,
        "max_raw": 2.319485816773612,
        "rotation_deg": 17.333638907485017,
        "rpe_1": 0.13956750442571098,
        "rpe_1_deg": 0.23837136218503135,
        "rpe_7": 0.850909296415991,
        "rpe_7_deg": 1.3960212392067999,
        "ape_se": 0.07842017155791386,
        "ape_similarity": 0.07815702355666182,
        "ape_origin": 2.092134343673293,
    },
    3: {
        "ape_raw": 2.274477957399504,
        "max_raw": 2.3579666383766145,
        "rotation_deg": 17.33843816414048,
        "rpe_1": 0.14135377425405257,
        "rpe_1_deg": 0.42625004315575454,
        "rpe_7": 0.8513808831724481,
        "rpe_7_deg": 1.4241169936276377,
        "ape_se": 0.08116569226451263,
        "ape_similarity": 0.08090654346094334,
        "ape_origin": 2.0935273680460273,
    },
}


@pytest.mark.parametrize("space_dim", [2, 3])
def test_agrees_with_an_independent_tool(space_dim, truth_of, trajectory_of):
    true, estimated = reference_poses(space_dim)
    truth, trajectory = truth_of(true), trajectory_of(estimated)
    similarity = align_points(estimated[:, :-1, -1], true[:, :-1, -1], with_scale=True)
    moved = similarity.points(estimated[:, :-1, -1])
    scaled = trajectory_of(pose(estimated[:, :-1, :-1], moved))
    ours = {
        "ape_raw": accuracy.ate(trajectory, truth),
        "max_raw": accuracy.max_error(trajectory, truth),
        "rotation_deg": accuracy.heading_rmse_deg(trajectory, truth),
        "rpe_1": accuracy.rpe_translation(trajectory, truth),
        "rpe_1_deg": accuracy.rpe_rotation_deg(trajectory, truth),
        "rpe_7": accuracy.rpe_translation(trajectory, truth, delta_frames=7),
        "rpe_7_deg": accuracy.rpe_rotation_deg(trajectory, truth, delta_frames=7),
        "ape_se": accuracy.ate_aligned(trajectory, truth),
        "ape_similarity": accuracy.ate(scaled, truth),
        "ape_origin": accuracy.ate_first_pose(trajectory, truth),
    }
    assert ours == pytest.approx(INDEPENDENT[space_dim], abs=1e-9)
    first = align_first_pose(estimated, true).T_true_estimated @ estimated[0]
    np.testing.assert_allclose(first, true[0], atol=1e-12)
