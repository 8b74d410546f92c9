"""Victoria Park, Sydney, as it was recorded: laser, wheels, steering and GPS of a car (Guivant, Nebot).

The folder holds the ASCII files of the archive: ``LASER.txt`` (one line of 362 numbers a scan: time, then 361
ranges half a degree apart from right to left), ``DRS.txt`` (time, speed of the left rear wheel, steering) and
``GPS.txt`` (time, north, east). Trees are found in the scans by tree_trunks.py; nobody tells which is which.

========  ==========================================================================
symbol    meaning (car.bmp of the archive)
========  ==========================================================================
v_e       speed of the left rear wheel's encoder [m/s]
alpha     steering [rad]
L, H      wheelbase 2.83 m; from the middle of the rear axle to its left wheel 0.76 m
a, b      the laser from the middle of the rear axle: 3.78 m ahead, 0.5 m to the left
v, omega  speed of the middle of the rear axle, turn rate
========  ==========================================================================

``v = v_e / (1 - tan(alpha) H / L)``, ``omega = v tan(alpha) / L`` (Ackermann). The body of the log is the
laser, which moves by ``(v - b omega, a omega, omega)``, so that its detections are what it measured.

The GPS has position only, with gaps that add up to most of the drive, and jumps. Its fixes are the truth
where two of them, at most ``GAP_S`` apart, move as a car does; the heading there is the course between them,
less the side slip that the laser's place has in a bend. Elsewhere the truth is not known, and no score uses
the frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.folders import find_folder, number_table, require_file
from slamcmp.datasets.plain.plain_motion import Motion
from slamcmp.datasets.plain.planar_log import PlanarStart, PlanarTruth, planar_log
from slamcmp.datasets.text import read_text
from slamcmp.datasets.tree_trunks import TrunkSize, find_trunks
from slamcmp.errors import DataError
from slamcmp.geometry import se2
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, Log

Positive = Annotated[float, Gt(0)]

WHEELBASE_M, WHEEL_M = 2.83, 0.76
LASER_AHEAD_M, LASER_LEFT_M = 3.78, 0.5
BEAMS = 361
PRIOR_SIGMA = 1e-6
"""Of the first pose [m, rad]: it is the origin."""
GAP_S = 0.5
"""Between two fixes that a truth is taken from."""
SLOWEST_M_S, FASTEST_M_S = 0.8, 8.0
"""Speeds between two fixes at which their course is a heading, and no jump."""
_NAMES = ("LASER.txt", "DRS.txt", "GPS.txt")


def _folder(path: str) -> Path:
    return find_folder(
        path,
        what="the log in ASCII (DRS, GPS, LASER)",
        origin="slamcmp data info victoria_park says where from",
    )


def _files(path: str = "victoria_park", **_: Any) -> list[Path]:
    return [file for file in (_folder(path) / name for name in _NAMES) if file.is_file()]


@sources.register("victoria_park_raw", seeded=False, files=_files, paths=("path",))
def victoria_park_raw(
    seed: int = 0,  # noqa: ARG001
    *,
    path: str = "victoria_park",
    seconds: Positive | None = None,
    range_sigma_m: Positive = 0.3,
    bearing_sigma_deg: Positive = 0.7,
    max_range_m: Positive = 35.0,
    thickest_m: Positive = 1.2,
    fewest_beams: Annotated[int, Ge(1)] = 2,
    speed_sigma_m_s_sqrt_s: Positive = 0.1,
    turn_sigma_rad_sqrt_s: Positive = 0.02,
    side_sigma_m_sqrt_s: Positive = 0.03,
) -> Log:
    """Victoria Park as recorded: trees found in laser scans, no labels, GPS truth with gaps.

    ``path`` is the folder with the archive's ASCII files. There is a frame for each scan; ``seconds`` keeps
    the first of them. Trunks up to ``thickest_m`` that at least ``fewest_beams`` hit within ``max_range_m``
    are detections. ``speed_…``, ``turn_…`` and ``side_sigma_…_sqrt_s`` are densities of the noise of the rear
    axle's motion, carried to the laser. Association is the front end's work: ``associated``.

    Raises:
        MissingDataError: the folder or a file is not there.
        DataError: a file does not hold what it should, or no scan lies within the odometry's time.
    """
    folder = _folder(path)
    for name in _NAMES:
        require_file(folder / name, "a file of Victoria Park's log")
    motion = _motion(folder / "DRS.txt", speed_sigma_m_s_sqrt_s, turn_sigma_rad_sqrt_s, side_sigma_m_sqrt_s)
    t, scans = _scans(folder / "LASER.txt")
    inside = (t >= motion.t[0]) & (t <= motion.t[-1])
    if seconds is not None:
        inside &= t <= t[0] + seconds
    t, scans = t[inside], scans[inside]
    if not t.size:
        raise DataError(f"{folder / 'LASER.txt'}: no scan lies within the odometry's time")
    bearings = np.radians(0.5 * np.arange(BEAMS) - 90.0)
    size = TrunkSize(farthest_m=max_range_m, thickest_m=thickest_m, beams=fewest_beams)
    R = np.diag([range_sigma_m, np.radians(bearing_sigma_deg)]) ** 2
    detections = []
    for scan in scans:
        trunks = find_trunks(scan, bearings, size)
        nobody = np.full(len(trunks), -1, dtype=np.int64)
        detections.append(Detections(trunks[:, :2], np.tile(R, (len(trunks), 1, 1)), nobody))
    return planar_log(
        "victoria_park_raw",
        motion,
        np.zeros(3),
        t,
        detections,
        make_sensor("range_bearing", {}),
        start=PlanarStart("origin", PRIOR_SIGMA, PRIOR_SIGMA),
        truth=PlanarTruth(_truth(folder / "GPS.txt", t, motion)),
        landmarks=(np.empty(0, np.int64), np.empty((0, 2))),
    )


def _motion(path: Path, speed_sigma: float, turn_sigma: float, side_sigma: float) -> Motion:
    """Twists of the laser, with the covariance of each step in the body frame of its end."""
    t, v_e, alpha = number_table(path, 3).T
    dt = np.diff(t)
    if t.size < 2 or (dt <= 0).any():
        row = int(np.argmax(dt <= 0)) + 2 if t.size > 1 else 1
        raise DataError(f"{path}: row {row}: odometry needs two rows or more, with times that increase")
    v = v_e / (1.0 - np.tan(alpha) * WHEEL_M / WHEELBASE_M)
    omega = v * np.tan(alpha) / WHEELBASE_M
    twists = np.stack([v - LASER_LEFT_M * omega, LASER_AHEAD_M * omega, omega], axis=1)[:-1]
    G = np.array([[1.0, 0.0, -LASER_LEFT_M], [0.0, 1.0, LASER_AHEAD_M], [0.0, 0.0, 1.0]])
    W = G @ np.diag(np.square([speed_sigma, side_sigma, turn_sigma])) @ G.T
    return Motion(t, twists, W * dt[:, None, None])


def _scans(path: Path) -> tuple[FloatArray, FloatArray]:
    """Times (K,) and ranges (K, 361) of a file that is one line."""
    try:
        numbers = np.array(read_text(path).split(), dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    if not numbers.size or numbers.size % (BEAMS + 1):
        raise DataError(
            f"{path}: {numbers.size} numbers; a scan has {BEAMS + 1}, its time and {BEAMS} ranges"
        )
    rows = numbers.reshape(-1, BEAMS + 1)
    back = np.flatnonzero(~(np.diff(rows[:, 0]) > 0))
    if back.size:
        raise DataError(f"{path}: scan {back[0] + 2}: its time does not come after that of the scan before")
    return rows[:, 0], rows[:, 1:]


def _truth(path: Path, t: FloatArray, motion: Motion) -> FloatArray:
    """Poses (K, 3, 3) at times t (K,) between fixes that belong together; NaN elsewhere."""
    stamps, north, east = number_table(path, 3).T
    dt = np.diff(stamps)
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.hypot(np.diff(east), np.diff(north)) / dt
    good = (dt > 0) & (dt <= GAP_S) & (speed >= SLOWEST_M_S) & (speed <= FASTEST_M_S)
    poses = np.full((t.size, 3, 3), np.nan)
    first = np.searchsorted(stamps, t, side="right") - 1
    for k in np.flatnonzero((first >= 0) & (first < dt.size)).tolist():
        i = int(first[k])
        if not good[i]:
            continue
        share = (t[k] - stamps[i]) / dt[i]
        x, y = (float(each[i] + share * (each[i + 1] - each[i])) for each in (east, north))
        row = min(int(np.searchsorted(motion.t, t[k], side="right")) - 1, len(motion.twists) - 1)
        slip = np.arctan2(motion.twists[row, 1], motion.twists[row, 0])
        course = np.arctan2(north[i + 1] - north[i], east[i + 1] - east[i])
        poses[k] = se2(x, y, course - slip)
    return poses
