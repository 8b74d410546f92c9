"""Which measurements of a frame bring new landmarks, and which of the others have an image at all.

A sensor that places a landmark by one measurement brings new ones by measuring them. Any other, such as a
single camera, brings them in ``Frame.entries``, measured by ``entry_sensor``; what it measures of a landmark
that is not in the map (any more) has no use. A landmark behind a camera has no predicted image, so nothing
can be learnt from measuring it: GTSAM and the sliding window give it a constant error without derivatives,
filters leave the measurement out. Filters count both as ``dropped``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slamcmp.errors import DataError, DivergedError
from slamcmp.models.camera import Camera
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import BoolArray, FloatArray, Frame, IntArray, SensorModel

MOST_WITHOUT_IMAGE = 0.5
"""Largest share of a frame's measurements that may be of landmarks without an image; above it the estimate
is taken for lost."""


class Entries(NamedTuple):
    """Landmarks that enter the map, measured by the entry sensor."""

    ids: IntArray
    """(m,)."""
    z: FloatArray
    """(m, d)."""
    R: FloatArray
    """(m, d, d)."""
    dropped: int
    """How many of the frame's other measurements are of landmarks that are unknown and cannot enter."""


def places_by_itself(sensor: SensorModel) -> bool:
    """Whether one measurement of the sensor tells where a landmark is."""
    return entry_sensor(sensor) is sensor


def entering(frame: Frame, unknown: BoolArray, sensor: SensorModel) -> Entries:
    """The landmarks that enter with a frame, of whose measurements those marked are of unknown landmarks."""
    if places_by_itself(sensor):
        return Entries(frame.ids[unknown], frame.z[unknown], frame.R[unknown], 0)
    strangers = int(unknown.sum())
    if frame.entries is None:
        return Entries(frame.ids[:0], np.empty((0, 0)), np.empty((0, 0, 0)), strangers)
    return Entries(frame.entries.ids, frame.entries.z, frame.entries.R, strangers)


def placed(sensor: SensorModel, T: FloatArray, entries: Entries, k: int) -> FloatArray:
    """Where the entry sensor at pose T puts the landmarks, (m, n).

    Raises:
        DataError: a measurement has no landmark, as a disparity that is not positive.
    """
    positions = sensor.invert(T, entries.z)
    if not np.isfinite(positions).all():
        row = int(np.argmin(np.isfinite(positions).all(axis=1)))
        raise DataError(
            f"frame {k}: landmark {entries.ids[row]} cannot be placed by its measurement "
            f"{np.array2string(entries.z[row], precision=6)} of sensor {sensor.name!r}; a front end must not "
            "let it enter"
        )
    return positions


def has_blind_side(sensor: SensorModel) -> bool:
    """Whether there are landmarks that the sensor cannot predict a measurement of."""
    return isinstance(sensor, Camera)


def with_image(z_predicted: FloatArray, k: int) -> BoolArray:
    """Which of a frame's predicted measurements (m, d) exist, (m,).

    Raises:
        DivergedError: most do not.
    """
    exists = np.asarray(np.isfinite(z_predicted).all(axis=1), dtype=bool)
    if exists.size - exists.sum() > MOST_WITHOUT_IMAGE * exists.size:
        raise DivergedError(
            f"frame {k}: of {exists.size} landmarks that the camera sees only {exists.sum()} are in front of "
            "it by the estimate, which is lost"
        )
    return exists


def errors(sensor: SensorModel, T: FloatArray, landmarks: FloatArray, z: FloatArray) -> FloatArray:
    """h(T, l) - z, (..., d); without an image 2 fx in every component, which is what GTSAM has there."""
    z_predicted = sensor.predict(T, landmarks)
    error: FloatArray = -sensor.residual(z, z_predicted)
    if isinstance(sensor, Camera):
        error[~np.isfinite(z_predicted).all(axis=-1)] = 2.0 * sensor.fx_px
    return error


def derivatives(sensor: SensorModel, T: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Those of ``errors`` by the pose (..., d, p) and the landmark (..., d, n): zero without an image."""
    H_pose, H_land = sensor.jacobians(T, landmarks)
    hidden = behind(sensor, T, landmarks)
    if hidden is not None:
        H_pose[hidden], H_land[hidden] = 0.0, 0.0
    return H_pose, H_land


def behind(sensor: SensorModel, T: FloatArray, landmarks: FloatArray) -> BoolArray | None:
    """Which landmarks (..., n) have no image, (...); None for a sensor that has no blind side."""
    if not isinstance(sensor, Camera):
        return None
    return np.asarray(~(sensor.camera_point(T, landmarks)[..., 2] > 0), dtype=bool)
