"""UTIAS MRCLAM: five robots among fifteen barcoded landmarks, tracked by Vicon.

* Title: UTIAS Multi-Robot Cooperative Localization and Mapping Dataset; nine sets of about 13 MB.
* Citation: K. Leung, Y. Halpern, T. Barfoot, H. Liu, "The UTIAS multi-robot cooperative localization and
  mapping dataset", International Journal of Robotics Research 30(8), 2011.
* Address: ftp://asrl3.utias.utoronto.ca/MRCLAM/MRCLAM<N>.zip. Licence: none is stated.

Nine sets, each a folder of text files (MRCLAM_Dataset1 to 9): odometry (commanded velocities at 67 Hz),
measurements (range and bearing of barcodes), the robots' and the landmarks' true places. One robot at a time
is a planar log; the other robots it saw are left out.

The measurement files name *barcodes*, whatever their header says; ``Barcodes.dat`` tells whose they are:
subjects 1 to 5 are robots, 6 to 20 landmarks. In set 1 the barcodes of subjects 11 and 17 are exchanged.
What is commanded leads what is driven by about 0.2 s and is 5 to 13 % too long. Stamps occur twice in a row:
then the last command is the one that holds.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Interval

from slamcmp.datasets.folders import find_folder, number_table, require_file
from slamcmp.datasets.plain.plain_motion import Motion
from slamcmp.datasets.plain.planar_log import PlanarStart, PlanarTruth, planar_log, planar_poses_at
from slamcmp.datasets.trajectories import MAX_GAP_S
from slamcmp.errors import DataError
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, IntArray, Log

ORIGIN = (
    "MRCLAM_Dataset<N> with Barcodes.dat, Landmark_Groundtruth.dat and the Robot<n>_*.dat files, from "
    "ftp://asrl3.utias.utoronto.ca/MRCLAM/MRCLAM<N>.zip"
)
FIRST_LANDMARK = 6
"""Subjects below are robots."""
EXCHANGED_IN_SET_1 = (11, 17)

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]


def _paths(path: str, robot: int) -> dict[str, Path]:
    folder = find_folder(path, what="a set of MRCLAM", origin=ORIGIN)
    return {
        "barcodes": folder / "Barcodes.dat",
        "landmarks": folder / "Landmark_Groundtruth.dat",
        **{
            kind: folder / f"Robot{robot}_{kind.capitalize()}.dat"
            for kind in ("odometry", "measurement", "groundtruth")
        },
    }


def _files(path: str, robot: int = 1, **_: Any) -> list[Path]:
    return [file for file in _paths(path, robot).values() if file.is_file()]


@sources.register("mrclam", seeded=False, files=_files, paths=("path",))
def mrclam(
    seed: int = 0,  # noqa: ARG001
    *,
    path: str,
    robot: Annotated[int, Interval(ge=1, le=5)] = 1,
    ids: Literal["known", "none"] = "known",
    range_sigma_m: Positive = 0.05,
    range_sigma_per_m: NotNegative = 0.03,
    bearing_sigma_deg: Positive = 1.5,
    max_range_m: Positive | None = None,
    along_sigma_m_sqrt_s: Positive = 0.02,
    across_sigma_m_sqrt_s: Positive = 0.005,
    turn_sigma_rad_sqrt_s: Positive = 0.03,
    odometry_offset_s: float = 0.0,
    frames: Literal["detections", "odometry"] = "detections",
    truth_max_gap_s: Positive = MAX_GAP_S,
    start: Literal["truth", "origin"] = "truth",
    prior_position_sigma_m: NotNegative = 1e-3,
    prior_heading_sigma_rad: NotNegative = 1e-3,
    noise: str | None = None,
) -> Log:
    """One robot of UTIAS MRCLAM (Leung et al. 2011): barcodes seen by a camera, truth by Vicon.

    ``path`` is a folder ``MRCLAM_Dataset<N>`` of the archive. There is a frame for each instant at which a
    landmark was measured, and with ``frames: odometry`` for each command too. ``ids: none`` hides who was
    seen: association is then the front end's work. Ranges are measured to ``range_sigma_m`` and
    ``range_sigma_per_m`` of their length (squares added); those above ``max_range_m`` are dropped where it is
    given. ``along_…``, ``across_…`` and ``turn_sigma_…_sqrt_s`` are densities of the odometry's noise.
    ``odometry_offset_s`` is added to the odometry's stamps: commands lead the motion by about 0.2 s. Without
    a file of true poses (set 2 in some collections) the robot starts at the origin, and only the landmarks
    are known. ``noise`` says where the sigmas come from, and then the results say it.

    Raises:
        MissingDataError: the folder or a file is not there.
        DataError: a file does not hold what the archive's does.
    """
    files = _paths(path, robot)
    for kind in ("barcodes", "landmarks", "odometry", "measurement"):
        require_file(files[kind], f"the {kind} of MRCLAM's archive")
    subject_of = _subjects(files["barcodes"])
    motion = _motion(files["odometry"], odometry_offset_s)
    rows = number_table(files["measurement"], 4)
    warnings: list[str] = [] if noise is None else [f"noise: {noise}"]
    subjects = np.array([subject_of.get(code, 0) for code in rows[:, 1].astype(np.int64).tolist()])
    rows, subjects = _of_landmarks(rows, subjects, motion, max_range_m, warnings)
    t = np.union1d(rows[:, 0], motion.t if frames == "odometry" else [])
    place = np.searchsorted(t, rows[:, 0])
    sigma = np.stack(
        [
            np.hypot(range_sigma_m, range_sigma_per_m * rows[:, 2]),
            np.full(len(rows), np.radians(bearing_sigma_deg)),
        ],
        axis=1,
    )
    R = sigma[:, :, None] ** 2 * np.eye(2)
    named = subjects if ids == "known" else np.full_like(subjects, -1)
    order = np.argsort(place, kind="stable")
    detections = [
        Detections(rows[at, 2:4], R[at], named[at])
        for at in np.split(order, np.cumsum(np.bincount(place, minlength=t.size))[:-1])
    ]
    sites = number_table(files["landmarks"], 3)
    truth = None
    if files["groundtruth"].is_file():
        true = number_table(files["groundtruth"], 4)
        true = true[np.unique(true[:, 0], return_index=True)[1]]
        truth = PlanarTruth(planar_poses_at(t, true[:, 0], true[:, 1:], max_gap_s=truth_max_gap_s))
    else:
        warnings.append(
            f"{files['groundtruth'].name} is not there: no true poses, and the start is the origin"
        )
    return planar_log(
        f"{files['odometry'].parent.name}_robot{robot}",
        motion,
        np.array([along_sigma_m_sqrt_s, across_sigma_m_sqrt_s, turn_sigma_rad_sqrt_s]),
        t,
        detections,
        make_sensor("range_bearing", {}),
        start=PlanarStart(start, prior_position_sigma_m, prior_heading_sigma_rad),
        truth=truth,
        landmarks=(sites[:, 0].astype(np.int64), sites[:, 1:3]),
        warnings=warnings,
    )


def _subjects(path: Path) -> dict[int, int]:
    """Of each barcode the subject that wears it.

    Raises:
        DataError: a barcode or a subject stands twice.
    """
    table = number_table(path, 2)[:, :2].astype(np.int64)
    for column, what in enumerate(("subject", "barcode")):
        values, counts = np.unique(table[:, column], return_counts=True)
        if counts.max() > 1:
            raise DataError(f"{path}: {what} {values[np.argmax(counts)]} stands twice")
    subject_of = {int(code): int(subject) for subject, code in table}
    if re.fullmatch(r"MRCLAM_?Dataset1", path.parent.resolve().name, re.IGNORECASE):
        code_of = {subject: code for code, subject in subject_of.items()}
        one, other = EXCHANGED_IN_SET_1
        if one in code_of and other in code_of:
            subject_of[code_of[one]], subject_of[code_of[other]] = other, one
    return subject_of


def _motion(path: Path, offset_s: float) -> Motion:
    rows = number_table(path, 3)
    if len(rows) < 2:
        raise DataError(f"{path}: {len(rows)} row(s) of odometry; at least two are needed")
    back = np.flatnonzero(np.diff(rows[:, 0]) < 0)
    if back.size:
        before, after = rows[back[0] : back[0] + 2, 0]
        raise DataError(
            f"{path}: row {back[0] + 2}: time {after:.3f} s comes before {before:.3f} s of the row before"
        )
    holds = np.append(np.diff(rows[:, 0]) > 0, True)
    t, v, omega = rows[holds].T
    return Motion(t + offset_s, np.stack([v, np.zeros_like(v), omega], axis=1)[:-1])


def _of_landmarks(
    rows: FloatArray, subjects: IntArray, motion: Motion, max_range_m: float | None, warnings: list[str]
) -> tuple[FloatArray, IntArray]:
    """The measurements that a log of one robot can use; what is left out is told."""
    reasons = {
        "of barcodes that nobody wears": subjects == 0,
        "of other robots": (subjects > 0) & (subjects < FIRST_LANDMARK),
        "outside the odometry's time": (rows[:, 0] < motion.t[0]) | (rows[:, 0] > motion.t[-1]),
        "that are not beyond range 0": rows[:, 2] <= 0,
    }
    if max_range_m is not None:
        reasons[f"of ranges above {max_range_m:g} m"] = rows[:, 2] > max_range_m
    kept = np.ones(len(rows), dtype=bool)
    for why, without in reasons.items():
        count = int((kept & without).sum())
        if count:
            warnings.append(f"left out {count} of {len(rows)} measurements {why}")
        kept &= ~without
    if not kept.any():
        raise DataError("no measurement of a landmark lies within the odometry's time")
    return rows[kept], subjects[kept]
