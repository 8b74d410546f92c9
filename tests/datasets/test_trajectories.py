"""Poses between recorded poses: against scipy's SLERP, closed forms and the limits where nothing is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from slamcmp.datasets.trajectories import (
    MAX_GAP_S,
    nearest_rotations,
    poses_at,
    read_kitti_poses,
    read_tum_trajectory,
)
from slamcmp.errors import DataError
from slamcmp.geometry import pose


def test_rotations_between_are_scipys_slerp() -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.uniform(0.02, 0.15, 30))
    rotations = Rotation.random(30, random_state=4)
    positions = rng.normal(size=(30, 3))
    t = np.sort(rng.uniform(stamps[0], stamps[-1], 200))
    found = poses_at(t, stamps, pose(rotations.as_matrix(), positions))
    np.testing.assert_allclose(found[:, :3, :3], Slerp(stamps, rotations)(t).as_matrix(), atol=1e-12)
    for axis in range(3):
        np.testing.assert_allclose(found[:, axis, 3], np.interp(t, stamps, positions[:, axis]), atol=1e-12)


def test_nothing_is_known_outside_and_in_gaps() -> None:
    stamps = np.array([0.0, 0.1, 0.1 + 2 * MAX_GAP_S, 0.2 + 2 * MAX_GAP_S])
    poses = pose(np.tile(np.eye(3), (4, 1, 1)), np.arange(12.0).reshape(4, 3))
    t = np.array([-0.01, 0.0, 0.05, 0.1, 0.3, stamps[2], stamps[3], stamps[3] + 0.01])
    known = np.isfinite(poses_at(t, stamps, poses)).all(axis=(1, 2))
    assert known.tolist() == [False, True, True, True, False, True, True, False]


def test_columns_of_a_tum_file(tmp_path: Path) -> None:
    """x, y, z, then the quaternion with w last: a quarter turn about z and a half turn about x."""
    path = tmp_path / "groundtruth.txt"
    half = np.sqrt(0.5)
    path.write_text(
        f"# t x y z qx qy qz qw\n2.5 1 2 3 0 0 {half} {half}\n2.0 4 5 6 1 0 0 0\n2.5 9 9 9 0 0 0 1\n"
    )
    stamps, poses = read_tum_trajectory(path)
    assert stamps.tolist() == [2.0, 2.5]
    np.testing.assert_allclose(poses[0, :3], [[1, 0, 0, 4], [0, -1, 0, 5], [0, 0, -1, 6]], atol=1e-15)
    np.testing.assert_allclose(poses[1, :3], [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0", r"truth\.txt:2: 6 fields where 8 are needed; is the file truncated"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0.1 0", "pose 1 has a quaternion of norm 0.1; 1 is needed"),
        ("0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1", r"truth\.txt:2: 'x' is not a finite number"),
        ("0 0 0 0 0 0 0 1\n1 0 0 nan 0 0 0 1", r"truth\.txt:2: 'nan' is not a finite number"),
        ("0 0 0 0 0 0 0 1", "1 pose.* at least two"),
        ("# nothing\n", "holds no line of 8 numbers"),
    ],
)
def test_what_is_wrong_with_a_trajectory_and_where(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "truth.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        read_tum_trajectory(path)


def test_skew_rotations_become_the_nearest_and_others_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    exact = Rotation.random(20, random_state=1).as_matrix()
    found = nearest_rotations(tmp_path, exact + 1e-4 * rng.normal(size=(20, 3, 3)))
    np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-12)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    assert np.abs(found - exact).max() < 5e-4
    for wrong in (np.diag([1.0, 1.0, -1.0]), 1.1 * np.eye(3), np.zeros((3, 3))):
        with pytest.raises(DataError, match="not a rotation"):
            nearest_rotations(tmp_path, wrong)


def test_a_kitti_row_is_the_upper_part_of_a_matrix(tmp_path: Path) -> None:
    path = tmp_path / "00.txt"
    path.write_text("1 0 0 5 0 1 0 6 0 0 1 7\n0 0 1 2 1 0 0 3 0 1 0 4\n")
    poses = read_kitti_poses(path)
    assert poses[0, :3, 3].tolist() == [5, 6, 7]
    np.testing.assert_allclose(poses[1, :3], [[0, 0, 1, 2], [1, 0, 0, 3], [0, 1, 0, 4]], atol=1e-15)
    path.write_text("1 0 0 5 0 1 0 6 0 0 1\n")
    with pytest.raises(DataError, match=r"00\.txt:1: 11 fields where 12 are needed"):
        read_kitti_poses(path)
