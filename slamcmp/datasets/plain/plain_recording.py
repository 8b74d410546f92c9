"""One's own log in plain files: odometry, detections, truth and landmarks, each a table with units.

The schema stands in docs/formats.md. There is a frame for each instant at which something was detected
(without detections, for each row of the odometry), within the time of the odometry.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.folders import find_data_file
from slamcmp.datasets.plain.column_files import Table, read_table
from slamcmp.datasets.plain.plain_motion import read_motion
from slamcmp.datasets.plain.planar_log import PlanarStart, PlanarTruth, as_planar, planar_log, planar_poses_at
from slamcmp.datasets.trajectories import MAX_GAP_S, poses_at, read_tum_trajectory
from slamcmp.errors import DataError
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, Log

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]

MEASURED = {
    "range_bearing": ("range", "bearing"),
    "relative_position": ("x", "y"),
    "range_only": ("range",),
    "bearing_only": ("bearing",),
}
"""Of each sensor the columns of its detections."""
TOLD_BY_COLUMNS = ("range_bearing", "relative_position")
"""Sensors that columns tell; beside a range or a bearing alone, one may have a name that is not known."""
_PATHS = ("odometry", "detections", "truth", "landmarks")
_LARGEST_ID = 1 << 50


def _files(**given: Any) -> list[Path]:
    return [find_data_file(given[name]) for name in _PATHS if given.get(name) is not None]


@sources.register("recording", seeded=False, files=_files, paths=_PATHS)
def recording(
    seed: int = 0,  # noqa: ARG001
    *,
    odometry: str,
    detections: str | None = None,
    truth: str | None = None,
    landmarks: str | None = None,
    sensor: Literal["range_only", "bearing_only"] | None = None,
    along_sigma_m_sqrt_s: Positive = 0.05,
    across_sigma_m_sqrt_s: Positive = 0.01,
    turn_sigma_rad_sqrt_s: Positive = 0.02,
    range_sigma_m: Positive | None = None,
    bearing_sigma_rad: Positive | None = None,
    position_sigma_m: Positive | None = None,
    metres_per_tick: Positive | None = None,
    track_m: Positive | None = None,
    odometry_offset_s: float = 0.0,
    detection_offset_s: float = 0.0,
    truth_offset_s: float = 0.0,
    truth_max_gap_s: Positive = MAX_GAP_S,
    frames: Literal["detections", "odometry"] = "detections",
    start: Literal["truth", "origin"] = "truth",
    start_pose: tuple[float, float, float] | None = None,
    prior_position_sigma_m: NotNegative = 1e-3,
    prior_heading_sigma_rad: NotNegative = 1e-3,
    noise: str | None = None,
) -> Log:
    """A planar log of one's own in CSV or Parquet files, with units in their headers (docs/formats.md).

    ``odometry``: ``t`` and velocities ``v, omega``, increments ``dx, dy, dtheta``, poses ``x, y, theta`` or
    wheel counts ``left, right`` (with ``metres_per_tick``, ``track_m``). ``detections``: ``t, id`` and
    ``range, bearing`` or ``x, y`` in the body frame; their sigmas are columns ``sigma_…``, or parameters.
    ``sensor``: ``range_only`` or ``bearing_only``, where that is all there is (front end ``delayed_start``).
    ``truth``: ``t, x, y, theta`` (sigmas make a covariance), or a .txt file in TUM's format; interpolated
    between poses at most ``truth_max_gap_s`` apart, elsewhere a gap. ``landmarks``: ``id, x, y``.
    The ``…_offset_s`` are added to the stamps of each file. ``along_…``, ``across_…`` and
    ``turn_sigma_…_sqrt_s`` are densities of the odometry's noise: variance grows with time. There is a frame
    for each instant of a detection, with ``frames: odometry`` for each row of the odometry too. ``start`` at
    the first true pose that is known at a frame, or at the origin; ``start_pose`` (x [m], y [m], theta [rad])
    at a pose that is told. ``noise`` says where the sigmas come from, and then the results say it.

    Raises:
        MissingDataError: a file is not there.
        DataError: a file does not hold what the schema says, or nothing lies within the odometry's time.
    """
    motion = read_motion(
        read_table(find_data_file(odometry)),
        metres_per_tick=metres_per_tick,
        track_m=track_m,
        offset_s=odometry_offset_s,
    )
    warnings: list[str] = [] if noise is None else [f"noise: {noise}"]
    sensor_name: str = sensor or "range_bearing"
    seen = None if detections is None else read_table(find_data_file(detections))
    if seen is None:
        t = motion.t
        per_frame = [np.empty(0, np.int64)] * t.size
    else:
        sensor_name = _sensor_of(seen, sensor)
        others = motion.t if frames == "odometry" else np.empty(0)
        t, per_frame = _instants(seen, detection_offset_s, motion.t, others, warnings)
    true = None if truth is None else _truth_at(find_data_file(truth), t, truth_offset_s, truth_max_gap_s)
    densities = np.array([along_sigma_m_sqrt_s, across_sigma_m_sqrt_s, turn_sigma_rad_sqrt_s])
    sites = None if landmarks is None else read_table(find_data_file(landmarks))
    numbers, own_ids = _numbering(
        [] if seen is None else seen.ids or [], [] if sites is None else sites.ids or []
    )
    model = make_sensor(sensor_name, {"space_dim": 2} if sensor_name == "relative_position" else {})
    sigmas = None
    if seen is not None:
        given = {
            "range": range_sigma_m,
            "bearing": bearing_sigma_rad,
            "x": position_sigma_m,
            "y": position_sigma_m,
        }
        sigmas = _sigmas(seen, MEASURED[sensor_name], given)
    for table in (seen, sites):
        warnings += [] if table is None else table.warnings
    return planar_log(
        Path(odometry).stem,
        motion,
        densities,
        t,
        [_frame_of(seen, rows, MEASURED[sensor_name], sigmas, numbers) for rows in per_frame],
        model,
        start=PlanarStart(start, prior_position_sigma_m, prior_heading_sigma_rad, start_pose),
        truth=true,
        landmarks=_sites(sites, numbers),
        warnings=warnings,
        own_ids=own_ids,
    )


def _sensor_of(table: Table, told: str | None) -> str:
    if told is not None:
        if not table.has("t", *MEASURED[told]):
            raise DataError(
                f"{table.path}: detections of sensor {told} have t, id and {MEASURED[told][0]}, with units; "
                f"found {', '.join(table.columns) or 'none'}"
            )
        return told
    kinds = [name for name in TOLD_BY_COLUMNS if table.has("t", *MEASURED[name])]
    if len(kinds) != 1:
        partly = " or ".join(name for name in ("range", "bearing") if table.has(name))
        why = ""
        if partly and not kinds:
            why = f" ({partly} alone does not place a landmark; say sensor: {partly}_only if it is all)"
        raise DataError(
            f"{table.path}: detections have t, id and either range and bearing, or x and y, with "
            "units; found "
            f"{', '.join(table.columns) or 'none'}{why}"
        )
    return kinds[0]


def _instants(
    table: Table, offset_s: float, known: FloatArray, others: FloatArray, warnings: list[str]
) -> tuple[FloatArray, list[Any]]:
    """The frames' times within the ``known`` ones, with the ``others``, and the rows of the table at each."""
    t = table.columns["t"] + offset_s
    inside = np.flatnonzero((t >= known[0]) & (t <= known[-1]))
    if not inside.size:
        raise DataError(
            f"{table.path}: none of its times, {t.min():.9g} to {t.max():.9g} s, is within those of "
            "the odometry, "
            f"{known[0]:.9g} to {known[-1]:.9g} s: another clock or unit? set detection_offset_s"
        )
    if inside.size < t.size:
        warnings.append(
            f"{table.path.name}: {t.size - inside.size} detections are outside the odometry's time"
        )
    times = np.union1d(t[inside], others)
    place = np.searchsorted(times, t[inside])
    order = np.argsort(place, kind="stable")
    return times, np.split(inside[order], np.cumsum(np.bincount(place, minlength=times.size))[:-1])


def _truth_at(path: Path, t: FloatArray, offset_s: float, max_gap_s: float) -> PlanarTruth:
    """The truth at times t (K,), with covariances where the file has sigmas."""
    if path.suffix == ".txt":
        stamps, spatial = read_tum_trajectory(path, parameter="a column t_ms, t_us or t_ns of a CSV file")
        return PlanarTruth(as_planar(poses_at(t, stamps + offset_s, spatial, max_gap_s=max_gap_s)))
    table = read_table(path)
    if not table.has("t", "x", "y", "theta"):
        raise DataError(f"{path}: truth has t, x, y, theta with units; found {', '.join(table.columns)}")
    order = np.unique(table.columns["t"], return_index=True)[1]
    stamps = table.columns["t"][order] + offset_s
    if stamps.size < 2:
        raise DataError(f"{path}: {stamps.size} pose(s); at least two are needed")
    recorded = np.stack([table.columns[name][order] for name in ("x", "y", "theta")], axis=1)
    poses = planar_poses_at(t, stamps, recorded, max_gap_s=max_gap_s)
    names = ("sigma_x", "sigma_y", "sigma_theta")
    if not table.has(*names):
        return PlanarTruth(poses)
    at = np.stack([np.interp(t, stamps, table.columns[name][order]) for name in names], axis=1)
    R = np.tile(np.eye(3), (t.size, 1, 1))
    R[:, :2, :2] = poses[:, :2, :2]
    # The file's x and y are the world's, the tangent's are the body's.
    return PlanarTruth(poses, np.swapaxes(R, 1, 2) @ (at[:, :, None] ** 2 * np.eye(3)) @ R)


def _numbering(*names: list[int | None]) -> tuple[dict[int, int], Any]:
    """Numbers that back ends can use, and where they are not the names, the names."""
    ordered = sorted({name for each in names for name in each if name is not None})
    if not ordered or (ordered[0] >= 0 and ordered[-1] <= _LARGEST_ID):
        return {name: name for name in ordered}, None
    return {name: number for number, name in enumerate(ordered)}, np.array(ordered, dtype=np.int64)


def _sigmas(table: Table, columns: tuple[str, ...], given: dict[str, float | None]) -> FloatArray:
    """(rows, d): of each detection's components."""
    found = []
    for name in columns:
        if table.has(f"sigma_{name}"):
            column = table.columns[f"sigma_{name}"]
            bad = np.flatnonzero(column <= 0)
            if bad.size:
                raise DataError(
                    f"{table.where(int(bad[0]))}: sigma_{name} is {column[bad[0]]:g}; positive is needed"
                )
            found.append(column)
        elif given[name] is not None:
            found.append(np.full(table.columns[name].size, given[name]))
        else:
            parameter = {"range": "range_sigma_m", "bearing": "bearing_sigma_rad"}.get(
                name, "position_sigma_m"
            )
            raise DataError(f"{table.path}: has no column sigma_{name}; set {parameter}, or give it one")
    return np.stack(found, axis=1)


def _frame_of(
    table: Table | None,
    rows: Any,
    columns: tuple[str, ...],
    sigmas: FloatArray | None,
    numbers: dict[int, int],
) -> Detections:
    if table is None or sigmas is None:
        d = len(columns)
        return Detections(np.empty((0, d)), np.empty((0, d, d)), np.empty(0, np.int64))
    z = np.stack([table.columns[name][rows] for name in columns], axis=1)
    R = sigmas[rows][:, :, None] ** 2 * np.eye(len(columns))
    names = [None] * len(rows) if table.ids is None else [table.ids[row] for row in rows]
    return Detections(
        z, R, np.array([-1 if name is None else numbers[name] for name in names], dtype=np.int64)
    )


def _sites(table: Table | None, numbers: dict[int, int]) -> tuple[Any, FloatArray]:
    if table is None:
        return np.empty(0, np.int64), np.empty((0, 2))
    if table.ids is None or not table.has("x", "y"):
        raise DataError(f"{table.path}: landmarks have id, x, y with units; found {', '.join(table.columns)}")
    if None in table.ids:
        raise DataError(f"{table.where(table.ids.index(None))}: a landmark without id")
    ids = np.array([numbers[name] for name in table.ids if name is not None], dtype=np.int64)
    return ids, np.stack([table.columns["x"], table.columns["y"]], axis=1)
