"""The landmarks of the DLR spatial-cognition data set: discs on the floor of a building, associated by hand.

* Title: DLR spatial cognition data set (``map.circles``, 1.6 MB): 3297 steps, 14 745 observations of discs,
  with the ids that a person gave them.
* Citation: J. Kurlbaum, U. Frese, "A benchmark data set for data association", SFB/TR 8 report 017-02/2009.
* Address: http://www.sfbtr8.spatial-cognition.de/insidedataassociation/. Licence: none is stated; no checksum
  is known.

The file has a line for each step of odometry, and after it one for each landmark in the image taken then::

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi
    LANDMARK_C pX pY quality cXX cXY cYY id [id …]

Its robot looks along -Y with X to the right, so that its Z points down and its angles grow clockwise. Read
here is x ahead, y to the left, angles counterclockwise: (x, y, theta) = (-Y, -X, -Phi). The covariance of a
step is in the frame before it; ours is in the tangent after it. Id -1 is a landmark that nobody identified;
one that was given several ids could be any of them, which is as little. There is no metric truth.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Interval

from slamcmp.datasets.folders import find_folder, numbers, require_file, text_rows
from slamcmp.datasets.text import whole
from slamcmp.errors import DataError
from slamcmp.geometry import rotation, se2
from slamcmp.models.sensors import make_sensor
from slamcmp.registry import sources
from slamcmp.types import Detections, FloatArray, Log, Problem

ORIGIN = "map.circles of http://www.sfbtr8.spatial-cognition.de/insidedataassociation/"
STEP, LANDMARKS = "STEP", ("LANDMARK_C", "LANDMARK")
"""The comment at the head of the file calls the second LANDMARK, its lines LANDMARK_C."""
AXES = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From (X, Y, Phi) to (x, y, theta)."""

NotNegative = Annotated[float, Ge(0)]


def _file(*, path: str) -> Path:
    folder = find_folder(path, what="a folder with map.circles", origin=ORIGIN)
    return folder / "map.circles"


def _files(*, path: str = "dlr", **_: object) -> list[Path]:
    return [_file(path=path)]


@sources.register("dlr", seeded=False, files=_files, paths=("path",))
def dlr(
    seed: int = 0,  # noqa: ARG001
    *,
    path: str = "dlr",
    steps: Annotated[int, Ge(2)] | None = None,
    ids: Literal["known", "none"] = "known",
    least_quality: Annotated[float, Interval(ge=0, le=1)] = 0.0,
    sensor_scale: Annotated[float, Gt(0)] = 1.0,
    odometry_scale: Annotated[float, Gt(0)] = 1.0,
    prior_position_sigma_m: NotNegative = 1e-3,
    prior_heading_sigma_rad: NotNegative = 1e-3,
) -> Log:
    """DLR's discs on a floor (Kurlbaum and Frese 2009): odometry, relative positions, associations by hand.

    ``path`` is a folder with ``map.circles``. A frame is a step of odometry and the image taken after it; its
    time is its number [s], for the file knows none. ``ids: none`` hides who was seen. Landmarks of a quality
    below ``least_quality`` are left out. The covariances are the file's, sigmas times ``sensor_scale`` and
    ``odometry_scale``. ``steps`` keeps the first frames.

    Raises:
        MissingDataError: the file is not there.
        DataError: a line is none of the format's, or a covariance is none.
    """
    file = require_file(_file(path=path), "steps and landmarks of the DLR data set")
    increments: list[FloatArray] = []
    covariances: list[FloatArray] = []
    seen: list[list[tuple[FloatArray, FloatArray, int]]] = []
    several = unsure = 0
    for where, fields in text_rows(file, 1):
        if fields[0] == STEP:
            if steps is not None and len(increments) == steps:
                break
            T, Q = _step(where, fields)
            increments.append(T)
            covariances.append(odometry_scale**2 * Q)
            seen.append([])
        elif fields[0] in LANDMARKS:
            if not seen:
                raise DataError(f"{where}: a landmark before the first {STEP}")
            z, R, quality, names = _landmark(where, fields)
            several += len(names) > 1
            if quality < least_quality:
                unsure += 1
                continue
            name = names[0] if len(names) == 1 and ids == "known" else -1
            seen[-1].append((z, sensor_scale**2 * R, name))
        else:
            raise DataError(f"{where}: begins with {fields[0]!r}; {STEP} or {LANDMARKS[0]} is needed")
    if len(increments) < 2:
        raise DataError(f"{file}: {len(increments)} step(s); at least two are needed")
    warnings = [f"left out {unsure} landmarks of a quality below {least_quality:g}"] if unsure else []
    if several and ids == "known":
        warnings.append(f"{several} landmarks were given several ids: read as identified by nobody")
    sigmas = np.array([prior_position_sigma_m, prior_position_sigma_m, prior_heading_sigma_rad])
    # The log starts where the first image was taken; the step before it leads from nowhere.
    increments[0], covariances[0] = np.eye(3), np.zeros((3, 3))
    return Log(
        "dlr",
        Problem(np.eye(3), np.diag(sigmas**2), make_sensor("relative_position", {"space_dim": 2})),
        np.arange(len(increments), dtype=np.float64),
        np.stack(increments),
        np.stack(covariances),
        tuple(_detections(each) for each in seen),
        warnings=tuple(warnings),
    )


def _step(where: str, fields: list[str]) -> tuple[FloatArray, FloatArray]:
    """The increment (3, 3) and its covariance in the tangent after it (3, 3)."""
    if len(fields) != 11:
        raise DataError(f"{where}: {len(fields)} fields where 11 are needed; is the file truncated?")
    X, Y, Phi, xx, xy, yy, xp, yp, pp = numbers(where, fields[2:])
    x, y, theta = AXES @ [X, Y, Phi]
    T = se2(x, y, math.remainder(theta, 2 * math.pi))
    before = AXES @ np.array([[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]]) @ AXES.T
    turn = np.eye(3)
    turn[:2, :2] = rotation(T).T
    return T, _covariance(where, turn @ before @ turn.T)


def _landmark(where: str, fields: list[str]) -> tuple[FloatArray, FloatArray, float, list[int]]:
    """Position (2,), covariance (2, 2), quality and ids."""
    if len(fields) < 8:
        raise DataError(f"{where}: {len(fields)} fields where at least 8 are needed; is the file truncated?")
    X, Y, quality, xx, xy, yy = numbers(where, fields[1:7])
    axes = AXES[:2, :2]
    R = _covariance(where, axes @ np.array([[xx, xy], [xy, yy]]) @ axes.T)
    return axes @ [X, Y], R, quality, [whole(where, text) for text in fields[7:]]


def _covariance(where: str, P: FloatArray) -> FloatArray:
    P = 0.5 * (P + P.T)
    if float(np.linalg.eigvalsh(P)[0]) <= 0.0:
        raise DataError(f"{where}: its covariance is not positive definite")
    return P


def _detections(rows: list[tuple[FloatArray, FloatArray, int]]) -> Detections:
    z = np.array([z for z, _, _ in rows]).reshape(-1, 2)
    R = np.array([R for _, R, _ in rows]).reshape(-1, 2, 2)
    return Detections(z, R, np.array([name for _, _, name in rows], dtype=np.int64))
