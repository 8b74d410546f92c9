"""Plaza 1 and 2: a mower that hears its distance to four radio beacons (Djugash, Hamner, Roth 2009).

The gtsam wheel carries both: ``Plaza<N>_DR.txt`` has time, distance travelled and turn since the row before,
``Plaza<N>_TD.txt`` time, antenna, beacon and range, and ``Plaza<N>_.mat`` the path by GPS and the beacons'
true places, which only scores see. What the files do not say and their numbers do:

* Ranges are too long by a constant share, seven in a hundred, not by a constant length; what is left has a
  sigma of 0.55 m, hardly any outliers, and no correlation from one to the next.
* In Plaza 2 the truth's heading points backwards, and the odometry's gyro drifts by 0.3 degrees a second.
* In Plaza 1 the odometry's turns are, to the last digit, those of the truth's heading: its dead reckoning is
  better than any gyro's, and headings cannot be scored.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.datasets.folders import find_data_file, number_table
from slamcmp.datasets.plain.plain_motion import Motion
from slamcmp.datasets.plain.planar_log import PlanarStart, PlanarTruth, planar_log, planar_poses_at
from slamcmp.datasets.wheel import wheel_file
from slamcmp.errors import DataError
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, Log

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]

TRUTH_MAX_GAP_S = 0.5
"""Poses by GPS are 0.1 or 0.2 s apart, and now and then one is missing."""
BACKWARDS = {1: 0.0, 2: np.pi}
"""By how much the truth's heading is turned from the direction of travel [rad]."""


def _paths(number: int, path: str | None) -> dict[str, Path]:
    names = {kind: f"Plaza{number}_{ending}" for kind, ending in _ENDINGS.items()}
    if path is None:
        return {kind: wheel_file(name) for kind, name in names.items()}
    return {kind: find_data_file(f"{path}/{name}") for kind, name in names.items()}


_ENDINGS = {"odometry": "DR.txt", "ranges": "TD.txt", "truth": ".mat"}


def _files(number: int = 1, path: str | None = None, **_: Any) -> list[Path]:
    return list(_paths(number, path).values())


@sources.register("plaza", seeded=False, files=_files, paths=("path",))
def plaza(
    seed: int = 0,  # noqa: ARG001
    *,
    number: Literal[1, 2] = 1,
    path: str | None = None,
    range_scale: Positive = 1.0,
    range_sigma_m: Positive = 0.6,
    along_sigma_m_sqrt_s: Positive = 0.05,
    across_sigma_m_sqrt_s: Positive = 0.02,
    turn_sigma_rad_sqrt_s: Positive = 0.02,
    start: Literal["truth", "origin"] = "truth",
    prior_position_sigma_m: NotNegative = 1e-3,
    prior_heading_sigma_rad: NotNegative = 1e-3,
    noise: str | None = None,
) -> Log:
    """Plaza 1 or 2: odometry and ranges to four radio beacons, truth by GPS; front end ``delayed_start``.

    The files are those of the gtsam wheel, or of the folder ``path``. There is a frame for each range.
    ``range_scale`` multiplies the ranges, which are too long by a constant share. ``along_…``, ``across_…``
    and ``turn_sigma_…_sqrt_s`` are densities of the odometry's noise. ``start`` at the first true pose, or
    at the origin. ``noise`` says where the sigmas come from, and then the results say it.

    Raises:
        MissingDataError: the gtsam wheel is not installed, or a file is not there.
        DataError: a file does not hold what it should.
    """
    files = _paths(number, path)
    steps = number_table(files["odometry"], 3)
    if len(steps) < 2:
        raise DataError(f"{files['odometry']}: {len(steps)} row(s) of odometry; at least two are needed")
    dt = np.diff(steps[:, 0])
    if (dt <= 0).any():
        row = int(np.argmax(dt <= 0)) + 2
        raise DataError(f"{files['odometry']}: row {row}: its time does not come after the row's before")
    # A row tells what happened since the one before it.
    motion = Motion(
        steps[:, 0], np.stack([steps[1:, 1], np.zeros(dt.size), steps[1:, 2]], axis=1) / dt[:, None]
    )
    heard = number_table(files["ranges"], 4)
    inside = (heard[:, 0] >= motion.t[0]) & (heard[:, 0] <= motion.t[-1])
    warnings: list[str] = [] if noise is None else [f"noise: {noise}"]
    if number == 1:
        warnings.append("plaza1: the odometry's turns are those of its truth's heading, in its files")
    if not inside.all():
        warnings.append(f"{files['ranges'].name}: {int((~inside).sum())} ranges outside the odometry's time")
    heard = heard[inside]
    if not len(heard):
        raise DataError(f"{files['ranges']}: no range lies within the odometry's time")
    t, place = np.unique(heard[:, 0], return_inverse=True)
    order = np.argsort(place, kind="stable")
    detections = [
        Detections(
            range_scale * heard[rows, 3:4],
            np.full((rows.size, 1, 1), range_sigma_m**2),
            heard[rows, 2].astype(np.int64),
        )
        for rows in np.split(order, np.cumsum(np.bincount(place, minlength=t.size))[:-1])
    ]
    path_rows, beacons = _truth(files["truth"])
    path_rows[:, 3] += BACKWARDS[number]
    return planar_log(
        f"plaza{number}",
        motion,
        np.array([along_sigma_m_sqrt_s, across_sigma_m_sqrt_s, turn_sigma_rad_sqrt_s]),
        t,
        detections,
        make_sensor("range_only", {}),
        start=PlanarStart(start, prior_position_sigma_m, prior_heading_sigma_rad),
        truth=PlanarTruth(planar_poses_at(t, path_rows[:, 0], path_rows[:, 1:], max_gap_s=TRUTH_MAX_GAP_S)),
        landmarks=(beacons[:, 0].astype(np.int64), beacons[:, 1:3]),
        warnings=warnings,
    )


def _truth(path: Path) -> tuple[FloatArray, FloatArray]:
    """The path (rows, 4) as time, x, y, heading and the beacons (L, 3) as name, x, y, from a .mat file.

    Raises:
        DataError: it is none, or has no such tables.
    """
    from scipy.io import loadmat

    try:
        tables = loadmat(path)
    except Exception as error:
        # Whatever a reader of foreign bytes meets in them: of wrong ones it raises a dozen kinds.
        raise DataError(f"{path}: cannot be read as a MATLAB file: {error}") from error
    found = []
    for name, columns in (("GT", 4), ("TL", 3)):
        table = np.asarray(tables.get(name, np.empty((0, 0))), dtype=np.float64)
        if table.ndim != 2 or table.shape[1] < columns or not len(table):
            raise DataError(f"{path}: has no table {name!r} of {columns} columns; found {_names(tables)}")
        found.append(table[:, :columns].copy())
    order = np.unique(found[0][:, 0], return_index=True)[1]
    return found[0][order], found[1]


def _names(tables: dict[str, Any]) -> str:
    return ", ".join(sorted(name for name in tables if not name.startswith("__"))) or "none"
