"""Recorded trajectories: reading them, and the pose at another instant."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamcmp.datasets.folders import number_table
from slamcmp.datasets.time_stamps import TimeUnit, in_seconds
from slamcmp.errors import DataError
from slamcmp.geometry import pose, rotation_from_quaternion, so3_exp, so3_log
from slamcmp.types import FloatArray

MAX_GAP_S = 0.2
"""Between two recorded poses; over a longer gap an interpolated pose would be an invention."""


def read_tum_trajectory(
    path: Path,
    *,
    time_unit: TimeUnit = "auto",
    parameter: str = "time_unit",
    told: list[str] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Lines ``t x y z qx qy qz qw`` as time stamps (K,) [s] and poses (K, 4, 4), in the order of time.

    ``time_unit`` is that of the file; what :func:`~slamcmp.datasets.time_stamps.in_seconds` finds out is
    appended to ``told``, and its errors name the ``parameter``.

    Raises:
        DataError: a line with other than eight numbers, or a quaternion that is not near unit length.
    """
    table = number_table(path, 8, exactly=True)
    t = in_seconds(path, table[:, 0], time_unit, parameter=parameter, told=told)
    if told is not None:
        told += _out_of_order(path, t)
    return ordered(path, t, poses_from(path, table[:, 1:4], table[:, 4:8]))


def read_poses_at(
    path: Path,
    t: FloatArray,
    *,
    time_unit: TimeUnit,
    max_gap_s: float,
    parameters: tuple[str, str] = ("time_unit", "max_gap_s"),
    told: list[str] | None = None,
) -> FloatArray:
    """Poses (K, 4, 4) of a file in TUM's format at the times t (K,) [s]; NaN where it has none.

    ``parameters`` are the names under which a user sets unit and gap.

    Raises:
        DataError: not one of the times is within the file's, as with another clock or unit; see also
            :func:`read_tum_trajectory`.
    """
    stamps, poses = read_tum_trajectory(path, time_unit=time_unit, parameter=parameters[0], told=told)
    found = poses_at(t, stamps, poses, max_gap_s=max_gap_s)
    if not np.isfinite(found).all(axis=(1, 2)).any():
        raise DataError(
            f"{path}: has no pose at any of the log's {t.size} times, {t[0]:.9g} to {t[-1]:.9g} s; its "
            "own are from "
            f"{stamps[0]:.9g} to {stamps[-1]:.9g} s, between which it is interpolated where they are at most "
            f"{parameters[1]} ({max_gap_s:g} s) apart: another clock, a wrong {parameters[0]}, or "
            "sparser poses?"
        )
    return found


def read_kitti_poses(path: Path) -> FloatArray:
    """Lines of twelve numbers, the upper rows of (4, 4) matrices, as poses (K, 4, 4).

    Raises:
        DataError: a line with other than twelve numbers, or a matrix that is not a rotation.
    """
    table = number_table(path, 12, exactly=True).reshape(-1, 3, 4)
    return pose(nearest_rotations(path, table[:, :, :3]), table[:, :, 3])


def nearest_rotations(path: Path, matrices: FloatArray) -> FloatArray:
    """The rotations (..., 3, 3) nearest to matrices that rounding has made slightly skew.

    Raises:
        DataError: one is farther than 0.01 from any rotation.
    """
    left, _, right = np.linalg.svd(matrices)
    rotations: FloatArray = left @ right
    if not (np.linalg.det(rotations) > 0).all() or np.abs(rotations - matrices).max() > 0.01:
        raise DataError(f"{path}: a matrix that is not a rotation")
    return rotations


def poses_from(path: Path, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) of positions (K, 3) and quaternions (K, 4) as x, y, z, w.

    Raises:
        DataError: a quaternion that is not near unit length, as other columns would give.
    """
    # Numbers far from one would overflow in their squares.
    norms = np.linalg.norm(np.clip(quaternions, -1e6, 1e6), axis=-1)
    if (np.abs(norms - 1.0) > 0.01).any():
        worst = int(np.argmax(np.abs(norms - 1.0)))
        raise DataError(f"{path}: pose {worst} has a quaternion of norm {norms[worst]:.4g}; 1 is needed")
    return pose(rotation_from_quaternion(quaternions), positions)


def ordered(path: Path, t: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both sorted by time; of poses with the same stamp only the first.

    Raises:
        DataError: fewer than two poses.
    """
    stamps, first = np.unique(t, return_index=True)
    if stamps.size < 2:
        raise DataError(f"{path}: {stamps.size} pose(s); at least two are needed")
    return stamps, poses[first]


def _out_of_order(path: Path, t: FloatArray) -> list[str]:
    """What a reader must know of the stamps that are sorted, or left out as repeated."""
    back = np.flatnonzero(np.diff(t) < 0)
    repeated = t.size - np.unique(t).size
    found = []
    if back.size:
        found.append(
            f"{path.name}: time stamps go back at pose {back[0] + 1}; poses are taken in order of time"
        )
    if repeated:
        found.append(
            f"{path.name}: {repeated} pose(s) have the time stamp of another; of each the first counts"
        )
    return found


def poses_at(
    t: FloatArray, stamps: FloatArray, poses: FloatArray, *, max_gap_s: float = MAX_GAP_S
) -> FloatArray:
    """Poses (K, 4, 4) at times t (K,): positions linear, rotations by SLERP; NaN where nothing is recorded.

    Nothing is recorded before the first stamp, after the last one, and in gaps above ``max_gap_s``.
    """
    # A stamp may have been rounded on its way through a text file.
    rounding = 1e-6
    after = np.clip(np.searchsorted(stamps, t), 1, stamps.size - 1)
    before = after - 1
    length = stamps[after] - stamps[before]
    share = np.clip((t - stamps[before]) / length, 0.0, 1.0)
    R_before = poses[before, :3, :3]
    turn = so3_log(np.swapaxes(R_before, -1, -2) @ poses[after, :3, :3])
    positions = (1.0 - share)[:, None] * poses[before, :3, 3] + share[:, None] * poses[after, :3, 3]
    between = pose(R_before @ so3_exp(share[:, None] * turn), positions)
    on_stamp = np.minimum(np.abs(t - stamps[before]), np.abs(t - stamps[after])) <= rounding
    inside = (t >= stamps[0]) & (t <= stamps[-1]) & (length <= max_gap_s)
    return np.where((inside | on_stamp)[:, None, None], between, np.nan)
