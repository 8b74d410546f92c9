"""Trajectories as files: every format reads back what was written, and says what is wrong with others'."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slamcmp.datasets.trajectory_files import FORMATS, in_space, read_trajectory, write_trajectory
from slamcmp.errors import DataError, MissingDataError
from slamcmp.geometry import exp, se2
from slamcmp.types import Trajectory


def spatial(P: bool = True) -> Trajectory:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(5, 6, 6))
    covariances = A @ np.swapaxes(A, 1, 2) + 1e-3 * np.eye(6)
    t = 1413393212.0 + np.array([0.0, 0.05, 0.1, 0.15, 0.25])
    return Trajectory(t, exp(rng.normal(size=(5, 6))), covariances if P else None)


def planar() -> Trajectory:
    rng = np.random.default_rng(4)
    A = rng.normal(size=(4, 3, 3))
    poses = se2(*rng.normal(size=(3, 4)))
    return Trajectory(np.arange(4) * 0.1, poses, A @ np.swapaxes(A, 1, 2) + 1e-3 * np.eye(3))


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("trajectory", [spatial(), planar()], ids=["space", "plane"])
def test_what_is_written_is_read_again(tmp_path: Path, format: str, trajectory: Trajectory) -> None:
    suffix = format if format in ("csv", "parquet") else "txt"
    path = tmp_path / f"poses.{suffix}"
    write_trajectory(path, trajectory, format)  # type: ignore[arg-type]
    found = read_trajectory(path)
    assert found.format == format
    assert found.stamped == (format != "kitti")
    whole = format in ("csv", "parquet")
    poses = trajectory.T_world_body if whole else in_space(trajectory.T_world_body)
    np.testing.assert_allclose(found.trajectory.T_world_body, poses, atol=1e-14)
    # EuRoC's stamps are whole nanoseconds; a float of today's seconds holds a quarter of a microsecond.
    expected = np.arange(len(poses)) if format == "kitti" else trajectory.t
    np.testing.assert_allclose(found.trajectory.t, expected, rtol=0, atol=3e-7 if format == "euroc" else 0)
    if whole:
        np.testing.assert_array_equal(found.trajectory.P, trajectory.P)
    else:
        assert found.trajectory.P is None


def test_tables_without_covariance_have_none(tmp_path: Path) -> None:
    write_trajectory(tmp_path / "a.csv", spatial(P=False), "csv")
    assert read_trajectory(tmp_path / "a.csv").trajectory.P is None


def test_units_and_separators_of_a_table(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("# by hand\nt_ms;theta_deg;x_m;y_m;comment\n1000;90;1;2;a\n1500;180;3;4;b\n")
    found = read_trajectory(path).trajectory
    np.testing.assert_allclose(found.t, [1.0, 1.5])
    np.testing.assert_allclose(found.T_world_body[0], [[0, -1, 1], [1, 0, 2], [0, 0, 1]], atol=1e-15)


def test_eurocs_columns_behind_the_pose_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    rows = [f"{1413393212255760384 + k * 50_000_000},1,2,3,1,0,0,0,9,9,9" for k in range(3)]
    path.write_text("#timestamp, p_RS_R_x [m], more\n" + "\n".join(rows) + "\n")
    found = read_trajectory(path)
    assert found.format == "euroc"
    np.testing.assert_allclose(found.trajectory.T_world_body[:, :3, 3], [[1, 2, 3]] * 3)
    np.testing.assert_allclose(np.diff(found.trajectory.t), 0.05, atol=3e-7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no pose"),
        ("1 2 3\n4 5 6\n", "a line of 3 fields is no pose; known are tum"),
        ("t_s,x_m,y_m\n1,2,3\n", "columns t_s, x_m, y_m; needed are"),
        ("x_m,y_m,theta_rad\n1,2,3\n", "needed are t_s"),
        ("t_s,x_m,y_m,theta_rad\n1,2,3\n", ":2: 3 fields where the header has 4"),
        ("t_s,x_m,y_m,theta_rad\n1,2,3,east\n2,2,3,0\n", ":2: 'east' is not a finite number"),
        ("t_s,x_m,y_m,theta_rad\n1,2,3,0\n", r"1 pose\(s\); at least two"),
        ("t_s,x_m,y_m,theta_rad,P_00\n1,2,3,0,1\n2,2,3,0,1\n", "P_01 is missing"),
        (
            "t_s,x_m,y_m,theta_rad,P_00,P_01,P_02,P_11,P_12,P_22\n1,2,3,0,1,2,0,1,0,1\n2,2,3,0,1,0,0,1,0,1\n",
            "covariance of pose 0 is not positive definite",
        ),
        ("0 0 0 0 0 0 0 2\n1 0 0 0 0 0 0 1\n", "quaternion of norm 2"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 nan\n", ":2: 'nan' is not a finite number"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=said) as error:
        read_trajectory(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_times_belong_to_kitti(tmp_path: Path) -> None:
    trajectory = spatial()
    write_trajectory(tmp_path / "kitti.txt", trajectory, "kitti")
    write_trajectory(tmp_path / "tum.txt", trajectory, "tum")
    times = tmp_path / "times.txt"
    times.write_text("0.0\n0.1\n0.2\n0.3\n0.4\n")
    np.testing.assert_allclose(read_trajectory(tmp_path / "kitti.txt", times=times).trajectory.t[-1], 0.4)
    with pytest.raises(DataError, match="tum has time stamps of its own"):
        read_trajectory(tmp_path / "tum.txt", times=times)
    times.write_text("0.0\n0.1\n")
    with pytest.raises(DataError, match="2 times for the 5 poses"):
        read_trajectory(tmp_path / "kitti.txt", times=times)
    times.write_text("0.0\n0.1\n0.1\n0.3\n0.4\n")
    with pytest.raises(DataError, match="do not rise, at line 3"):
        read_trajectory(tmp_path / "kitti.txt", times=times)
    with pytest.raises(MissingDataError):
        read_trajectory(tmp_path / "none.txt")
