"""Trajectories of other programs as files: TUM, KITTI, EuRoC, and tables with named columns (CSV, Parquet).

A table's columns: ``t_s`` (or ms, us, ns); in the plane ``x_m y_m theta_rad`` (or deg), in space ``x_m y_m
z_m qx qy qz qw``; and, where known, the covariance of each pose in its body tangent, columns ``P_00`` … with
indices i ≤ j from 0 on, in the plane over (x, y, θ), in space over (rotation, translation).
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamcmp.datasets.folders import number_table, require_file, text_rows
from slamcmp.datasets.text import number, text_lines
from slamcmp.datasets.time_stamps import SECONDS, in_seconds
from slamcmp.datasets.trajectories import ordered, poses_from, read_kitti_poses, read_tum_trajectory
from slamcmp.errors import DataError
from slamcmp.geometry import quaternion, rotation, se2, se2_coordinates, translation
from slamcmp.support.files.atomic import write_atomically
from slamcmp.types import FloatArray, Trajectory

if TYPE_CHECKING:
    import pandas as pd

TrajectoryFormat = Literal["tum", "kitti", "euroc", "csv", "parquet"]
FORMATS: tuple[TrajectoryFormat, ...] = get_args(TrajectoryFormat)
SPACE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
PLANE = ("x_m", "y_m", "theta_rad")
EUROC_HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
)


@dataclass(frozen=True)
class ReadTrajectory:
    """What a file holds."""

    trajectory: Trajectory
    """Stamps [s] in rising order; of KITTI's, which have none, the number of the line."""
    format: TrajectoryFormat
    stamped: bool
    told: tuple[str, ...] = field(default=())
    """What a reader of results has to know: units, stamps out of order."""


def read_trajectory(
    path: Path, format: TrajectoryFormat | None = None, *, times: Path | None = None
) -> ReadTrajectory:
    """Read a trajectory; without ``format`` it is told by the file's content.

    ``times`` is a file with one stamp [s] a line for KITTI's poses.

    Raises:
        MissingDataError: there is no such file.
        DataError: it is not of that format, or of none that is known.
    """
    require_file(path, "a trajectory")
    kind = format or _told_by_content(path)
    told: list[str] = []
    if times is not None and kind != "kitti":
        raise DataError(f"{path}: {kind} has time stamps of its own; a file of times belongs to kitti")
    if kind == "kitti":
        poses = read_kitti_poses(path)
        if len(poses) < 2:
            raise DataError(f"{path}: {len(poses)} pose(s); at least two are needed")
        t = np.arange(len(poses), dtype=float) if times is None else number_table(times, 1)[:, 0]
        if t.size != len(poses):
            raise DataError(f"{times}: {t.size} times for the {len(poses)} poses of {path}")
        if (np.diff(t) <= 0).any():
            raise DataError(
                f"{times}: times that do not rise, at line {1 + int(np.argmax(np.diff(t) <= 0)) + 1}"
            )
        return ReadTrajectory(Trajectory(t, poses), kind, times is not None)
    if kind == "tum":
        stamps, poses = read_tum_trajectory(path, parameter="the unit", told=told)
        return ReadTrajectory(Trajectory(stamps, poses), kind, True, tuple(told))
    if kind == "euroc":
        return ReadTrajectory(_read_euroc(path, told), kind, True, tuple(told))
    columns = _parquet_columns(path) if kind == "parquet" else _csv_columns(path)
    return ReadTrajectory(_from_columns(path, columns, told), kind, True, tuple(told))


def write_trajectory(path: Path, trajectory: Trajectory, format: TrajectoryFormat) -> None:
    """Write a trajectory so that :func:`read_trajectory` finds it again; covariances go into tables only.

    A planar one becomes one in space, at z = 0, in the formats that know nothing else (tum, kitti, euroc).

    Raises:
        DataError: poses that are not finite.
        StorageError: the file cannot be written.
    """
    if not np.isfinite(trajectory.T_world_body).all():
        raise DataError(f"{path}: the trajectory has poses that are not finite")
    if format in ("csv", "parquet"):
        table = trajectory_table(trajectory)
        if format == "parquet":
            write_atomically(path, lambda file: table.to_parquet(file, index=False))
        else:
            _write_text(path, table.to_csv(index=False))
        return
    poses = in_space(trajectory.T_world_body)
    p, q = poses[:, :3, 3], np.stack([quaternion(R) for R in poses[:, :3, :3]])
    if format == "kitti":
        _write_text(path, _lines(poses[:, :3, :].reshape(-1, 12)))
    elif format == "tum":
        rows = np.column_stack([trajectory.t, p, q])
        _write_text(path, "# timestamp tx ty tz qx qy qz qw\n" + _lines(rows))
    else:
        stamps = [str(round(float(t) * 1e9)) for t in trajectory.t]
        values = np.column_stack([p, q[:, [3, 0, 1, 2]]])
        rows_text = [",".join([t, *map(repr, row)]) for t, row in zip(stamps, values.tolist(), strict=True)]
        _write_text(path, "\n".join([EUROC_HEADER, *rows_text]) + "\n")


def trajectory_table(trajectory: Trajectory) -> pd.DataFrame:
    """The columns of a table, covariances included where there are any."""
    import pandas as pd

    poses = trajectory.T_world_body
    if poses.shape[-1] == 3:
        columns = dict(zip(PLANE, se2_coordinates(poses).T, strict=True))
    else:
        q = np.stack([quaternion(R) for R in rotation(poses)])
        columns = dict(zip(SPACE, np.column_stack([translation(poses), q]).T, strict=True))
    table = pd.DataFrame({"t_s": trajectory.t, **columns})
    if trajectory.P is not None:
        p = trajectory.P.shape[-1]
        for i in range(p):
            for j in range(i, p):
                table[f"P_{i}{j}"] = trajectory.P[:, i, j]
    return table


def in_space(poses: FloatArray) -> FloatArray:
    """Planar poses (K, 3, 3) as ones in space (K, 4, 4) at z = 0; others as they are."""
    if poses.shape[-1] == 4:
        return poses
    found = np.broadcast_to(np.eye(4), (len(poses), 4, 4)).copy()
    found[:, :2, :2], found[:, :2, 3] = poses[:, :2, :2], poses[:, :2, 2]
    return found


def _told_by_content(path: Path) -> TrajectoryFormat:
    if path.suffix == ".parquet":
        return "parquet"
    lines = [line.strip() for line in text_lines(path)]
    first = next((line for line in lines if line and not line.startswith("#")), "")
    if not first:
        raise DataError(f"{path}: holds no pose")
    if any(separator in first for separator in ",;\t") or "t_s" in first:
        try:
            float(first.replace(";", ",").replace("\t", ",").split(",")[0])
        except ValueError:
            return "csv"
        return "euroc" if "," in first else "tum"
    fields = len(first.split())
    known: dict[int, TrajectoryFormat] = {8: "tum", 12: "kitti"}
    if fields not in known:
        raise DataError(
            f"{path}: a line of {fields} fields is no pose; known are tum (8: t x y z qx qy qz qw), kitti "
            "(12), euroc (commas: ns, position, quaternion w x y z) and csv (a header with t_s, x_m, …)"
        )
    return known[fields]


def _read_euroc(path: Path, told: list[str]) -> Trajectory:
    """Nanoseconds, position, quaternion as w, x, y, z; what follows (velocity, biases) is left out."""
    table = number_table(path, 8)
    try:
        stamps = np.array([int(fields[0]) for _, fields in text_rows(path, 8)], dtype=np.int64)
        t = stamps // 1_000_000_000 + 1e-9 * (stamps % 1_000_000_000)
    except (ValueError, OverflowError):
        t = in_seconds(path, table[:, 0], "auto", parameter="the unit", told=told)
    return Trajectory(*ordered(path, t, poses_from(path, table[:, 1:4], table[:, [5, 6, 7, 4]])))


def _csv_columns(path: Path) -> dict[str, FloatArray]:
    lines = [
        (k, line) for k, line in enumerate(text_lines(path), 1) if line.strip() and line.strip()[0] != "#"
    ]
    separator = next((each for each in ",;\t" if each in lines[0][1]), ",") if lines else ","
    header = [title.strip().strip('"') for title in lines[0][1].split(separator)] if lines else []
    columns: list[list[float]] = [[] for _ in header]
    for k, line in lines[1:]:
        fields = [text.strip().strip('"') for text in line.split(separator)]
        if len(fields) != len(header):
            raise DataError(f"{path}:{k}: {len(fields)} fields where the header has {len(header)}")
        for place, text in enumerate(fields):
            # A column that is no number may be there as long as nobody needs it.
            wanted = _wanted(header[place])
            unknown = wanted.startswith("P_") and text.lower() in ("", "nan")
            columns[place].append(math.nan if not wanted or unknown else number(f"{path}:{k}", text))
    return {title: np.array(column) for title, column in zip(header, columns, strict=True) if _wanted(title)}


def _parquet_columns(path: Path) -> dict[str, FloatArray]:
    import pandas as pd

    try:
        frame = pd.read_parquet(io.BytesIO(path.read_bytes()))
        return {str(title): frame[title].to_numpy(float) for title in frame if _wanted(str(title))}
    except Exception as error:
        raise DataError(f"{path}: not a Parquet file of numbers ({type(error).__name__})") from error


def _wanted(title: str) -> str:
    """The title itself where it means something here."""
    known = {*SPACE, *PLANE, "theta_deg", *(f"t_{unit}" for unit in SECONDS)}
    return title if title in known or title.startswith("P_") else ""


def _from_columns(path: Path, columns: Mapping[str, FloatArray], told: list[str]) -> Trajectory:
    clocks = [unit for unit in SECONDS if f"t_{unit}" in columns]
    angle = "theta_deg" if "theta_deg" in columns else "theta_rad"
    plane = ("x_m", "y_m", angle)
    if len(clocks) != 1 or not (_all(columns, SPACE) or _all(columns, plane)):
        raise DataError(
            f"{path}: columns {', '.join(columns) or 'none'}; needed are t_s (or ms, us, ns) and x_m, y_m, "
            "theta_rad (or deg) in the plane, or x_m, y_m, z_m, qx, qy, qz, qw in space"
        )
    t = SECONDS[clocks[0]] * columns[f"t_{clocks[0]}"]
    names = SPACE if _all(columns, SPACE) else plane
    values = np.column_stack([columns[name] for name in names])
    if not (len(t) and np.isfinite(values).all() and np.isfinite(t).all()):
        raise DataError(f"{path}: a pose or a stamp that is not finite, or no row")
    if names is SPACE:
        poses = poses_from(path, values[:, :3], values[:, 3:])
    else:
        poses = se2(values[:, 0], values[:, 1], values[:, 2] * (np.pi / 180 if angle == "theta_deg" else 1.0))
    P = _covariances(path, columns, 6 if names is SPACE else 3)
    order = np.unique(t, return_index=True)[1]
    if order.size < t.size:
        told.append(f"{path.name}: {t.size - order.size} pose(s) have the stamp of another; the first counts")
    stamps, poses = ordered(path, t, poses)
    return Trajectory(stamps, poses, None if P is None else P[order])


def _all(columns: Mapping[str, FloatArray], names: tuple[str, ...]) -> bool:
    return all(name in columns for name in names)


def _covariances(path: Path, columns: Mapping[str, FloatArray], p: int) -> FloatArray | None:
    """(K, p, p) from the columns ``P_00`` ….

    Raises:
        DataError: only some are there, or a matrix is not positive definite.
    """
    needed = {f"P_{i}{j}": (i, j) for i in range(p) for j in range(i, p)}
    given = [name for name in columns if name.startswith("P_")]
    if not given:
        return None
    missing = [name for name in needed if name not in columns]
    if missing or len(given) > len(needed):
        raise DataError(
            f"{path}: covariances need the columns P_00 … P_{p - 1}{p - 1}, the upper triangle"
            + (f"; {missing[0]} is missing" if missing else f"; {given[-1]} is not among them")
        )
    P = np.empty((len(columns["P_00"]), p, p))
    for name, (i, j) in needed.items():
        P[:, i, j] = P[:, j, i] = columns[name]
    known = np.isfinite(P).all(axis=(1, 2))
    wrong = np.flatnonzero(known)[np.linalg.eigvalsh(P[known])[:, 0] <= 0]
    if wrong.size:
        raise DataError(f"{path}: the covariance of pose {wrong[0]} is not positive definite")
    return P


def _lines(rows: FloatArray) -> str:
    # repr is the shortest text that reads back to the same bits.
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write(text.encode()))
