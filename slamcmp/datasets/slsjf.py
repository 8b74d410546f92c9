"""Huang's simulated range-bearing sets, published with OpenSLAM's 2d-i-slsjf (sparse local submap joining).

* Title: simulated data sets of 2-D I-SLSJF; set 8240 has 0.9 MB, 8241 poses, 40 524 sightings of 612 of its
  2500 beacons, known association, exact poses and beacons.
* Citation: S. Huang, Z. Wang, G. Dissanayake, "Sparse local submap joining filter for building large-scale
  maps", IEEE Transactions on Robotics 24(5), 2008.
* Address: https://openslam-org.github.io/2d-i-slsjf.html. Licence: that page's; none lies in the set.

A folder holds MATLAB files: ``store_speed`` and ``store_turnrate`` (what was driven, with noise),
``sensor_data`` (step, beacon, range, bearing, 0, 0, 0) and, as truth, ``store_robotTrue`` and
``store_beaconsTrue``. Steps are numbered from 1: sightings of step i are made from pose i - 1. What
its parameters.txt calls variances are standard deviations, and in set 8240 the turn rate's noise is 2.85
deg/s, where it says 2. Its robot passes beacons at 2 cm: range-bearing sightings from there let smoothers
give up at frame 8075, unless the front end has a least range.

The robot turns, then drives: T_prev_body = Rot(w dt) Trans(v dt, 0).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.folders import find_folder, require_file
from slamcmp.errors import DataError, UsageError
from slamcmp.geometry import se2
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, GroundTruth, Log, Problem

TIME_STEP_S = 0.3
PRIOR_SIGMA = 1e-6
"""Of the first pose [m, rad], which is told."""
ORIGIN = "the simulated data sets of OpenSLAM's 2d-i-slsjf, https://openslam-org.github.io/2d-i-slsjf.html"
WIDTH = {"sensor_data": 7, "store_beaconsTrue": 3}
"""Columns of the tables that have a row for each entry."""
PARTS = ("store_speed", "store_turnrate", "sensor_data", "store_robotTrue", "store_beaconsTrue")

Positive = Annotated[float, Gt(0)]


def _files(*, path: str, **_: object) -> list[Path]:
    folder = find_folder(path, what="a folder with store_speed.mat", origin=ORIGIN)
    return [folder / f"{part}.mat" for part in PARTS]


@sources.register("slsjf", seeded=False, files=_files, paths=("path",))
def slsjf(
    seed: int = 0,  # noqa: ARG001
    *,
    path: str = "slsjf_sim/8240",
    steps: Annotated[int, Ge(2)] | None = None,
    speed_sigma_m_s: Positive = 0.02,
    turn_sigma_deg_s: Positive = 2.0,
    lateral_sigma_m: Positive = 0.001,
    range_sigma_m: Positive = 0.1,
    bearing_sigma_deg: Positive = 1.0,
) -> Log:
    """Huang's simulated range-bearing set of OpenSLAM's 2d-i-slsjf: 8241 poses, 612 beacons, exact truth.

    ``path`` is the set's folder, as it is or under ``SLAMCMP_DATA``. The sigmas are those of its
    ``parameters.txt``; the turn rate's noise in set 8240 is really 2.85 deg/s. ``lateral_sigma_m`` of a step
    makes its covariance regular: the robot's model knows no sideways motion. ``steps`` keeps the first poses.

    Raises:
        MissingDataError: the folder or one of its files is not there.
        DataError: a file is damaged, or does not fit the others.
    """
    folder = find_folder(path, what="a folder with store_speed.mat", origin=ORIGIN)
    speed, turn = (_row(folder, name) for name in ("store_speed", "store_turnrate"))
    if speed.size != turn.size:
        raise DataError(f"{folder}: {speed.size} speeds in store_speed.mat for {turn.size} turn rates")
    robot = _table(folder, "store_robotTrue")
    if robot.shape != (3, speed.size + 1):
        raise DataError(f"{folder}/store_robotTrue.mat: {robot.shape} where (3, {speed.size + 1}) is needed")
    poses = robot.shape[1] if steps is None else steps
    if poses > robot.shape[1]:
        raise UsageError(f"slsjf: steps is {steps}, and {folder} has {robot.shape[1]} poses")
    v, w = speed[: poses - 1] * TIME_STEP_S, turn[: poses - 1] * TIME_STEP_S
    increments: FloatArray = np.tile(np.eye(3), (poses, 1, 1))
    increments[1:] = se2(v * np.cos(w), v * np.sin(w), w)
    Q = np.zeros((poses, 3, 3))
    noise = TIME_STEP_S * np.array([speed_sigma_m_s, math.radians(turn_sigma_deg_s)])
    Q[1:] = _increment_covariances(v, noise[0], noise[1], lateral_sigma_m)
    true_poses = se2(*robot[:, :poses])
    t = TIME_STEP_S * np.arange(poses, dtype=np.float64)
    beacons = _table(folder, "store_beaconsTrue")
    R = np.diag([range_sigma_m, math.radians(bearing_sigma_deg)]) ** 2
    return Log(
        folder.name,
        Problem(true_poses[0], PRIOR_SIGMA**2 * np.eye(3), make_sensor("range_bearing", {})),
        t,
        increments,
        Q,
        _detections(folder, poses, robot.shape[1], R),
        truth=GroundTruth(t, true_poses, beacons[:, 0].astype(np.int64), beacons[:, 1:]),
    )


def _increment_covariances(v: FloatArray, speed: float, turn: float, lateral: float) -> FloatArray:
    """(K, 3, 3) in the tangent of the later body: an error of the turn swings the way v (K,) sideways."""
    G = np.zeros((v.size, 3, 3))
    G[:, 0, 0] = speed
    G[:, 1, 1], G[:, 1, 2] = lateral, v * turn
    G[:, 2, 2] = turn
    covariances: FloatArray = G @ np.swapaxes(G, 1, 2)
    return covariances


def _detections(folder: Path, poses: int, all_poses: int, R: FloatArray) -> tuple[Detections, ...]:
    seen = _table(folder, "sensor_data")
    step = seen[:, 0]
    wrong = np.flatnonzero((step != np.round(step)) | (step < 1) | (step > all_poses))
    if wrong.size:
        row = int(wrong[0])
        raise DataError(
            f"{folder}/sensor_data.mat: row {row + 1} is of step {step[row]:g}; 1 to {all_poses} are poses"
        )
    order = np.argsort(step, kind="stable")
    seen = seen[order]
    first = np.searchsorted(seen[:, 0], np.arange(1, poses + 2))
    found = []
    for k in range(poses):
        rows = seen[first[k] : first[k + 1]]
        ids, z = rows[:, 1].astype(np.int64), rows[:, 2:4]
        found.append(Detections(z, np.broadcast_to(R, (ids.size, 2, 2)), ids))
    return tuple(found)


def _row(folder: Path, name: str) -> FloatArray:
    return _table(folder, name).ravel()


def _table(folder: Path, name: str) -> FloatArray:
    """The matrix of one file.

    Raises:
        MissingDataError: it is not there.
        DataError: it cannot be read, holds no such matrix, or numbers that are not finite.
    """
    from scipy.io import loadmat

    file = require_file(folder / f"{name}.mat", f"{name} of a set of 2d-i-slsjf")
    try:
        held = loadmat(file)
    # What a damaged file makes of it is whatever its bytes say.
    except Exception as error:
        raise DataError(f"{file}: no MATLAB file of version 4 to 7 ({type(error).__name__})") from error
    if name not in held:
        others = sorted(key for key in held if not key.startswith("__"))
        raise DataError(f"{file}: holds no matrix {name} (it has {', '.join(others) or 'none'})")
    table = np.asarray(held[name])
    width = WIDTH.get(name)
    if table.ndim != 2 or table.dtype.kind not in "fiu" or (width is not None and table.shape[1] != width):
        raise DataError(f"{file}: {table.shape} of {table.dtype} where a matrix of numbers is needed")
    table = table.astype(np.float64)
    if not np.isfinite(table).all():
        raise DataError(f"{file}: not every number is finite")
    return table
