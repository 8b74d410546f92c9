"""When a run's map moved away under it: the test for logs without truth.

A landmark that is seen again is placed by the run's pose of that moment, and lies where the run's own earlier
poses put it, within what both covariances allow. Where it does not, either the measurement is wrong or the
poses have moved against the map. One wrong measurement says little; so the landmarks are asked together, and
the map has shifted where more than two thirds of what was seen in a window lie too far off. Outliers of up to
three measurements in ten therefore raise no alarm, whether the back end believed them or not.

The covariance of the difference leaves out that the errors of two poses are correlated, which makes it too
large: a consistent run alarms less often than the limits say.

========  ================================================================
symbol    meaning
========  ================================================================
y, C      a sighting's landmark in the world (n,) and its covariance (n, n)
G         derivative of y by the pose's body-tangent error, (n, p)
========  ================================================================
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from slamcmp.metrics.divergence import WINDOW, Departure
from slamcmp.types import FloatArray, MeasurementStream, Run, SensorModel

TOO_FAR = 1e-4
"""Probability of a right sighting of a consistent run to count as too far off."""
SHARE = 2.0 / 3.0
"""Share of a window's sightings beyond which the map has shifted."""
FEWEST = 10
"""Sightings in a window below which nothing is said."""
BEFORE = 5
"""Earlier sightings that a landmark's place needs, so that two wrong ones do not decide it."""
REMEMBERED = 10
"""The first ones count: a map that moves slowly must not take its own past along."""


@dataclass
class _Place:
    """A landmark's first sightings."""

    frames: list[int] = field(default_factory=list)
    y: list[FloatArray] = field(default_factory=list)
    C: list[FloatArray] = field(default_factory=list)

    def before(self, k: int) -> tuple[FloatArray, FloatArray] | None:
        """Where those before frame k put it: their median, and the mean of their covariances."""
        count = sum(frame < k for frame in self.frames)
        if count < BEFORE:
            return None
        return np.median(self.y[:count], axis=0), np.mean(self.C[:count], axis=0)


def map_departure(stream: MeasurementStream, run: Run) -> Departure | None:
    """The first frame at which the map had shifted, or None where it never did, or nobody can tell.

    ``value`` is the number of sightings that were too far off in the window, ``dof`` of how many.
    """
    P = run.online.P
    if P is None:
        return None
    limit = float(chdtri(stream.problem.sensor.space_dim, TOO_FAR))
    places: dict[int, _Place] = {}
    window: deque[tuple[int, int]] = deque(maxlen=WINDOW)
    for k in range(min(run.online.t.size, len(stream.frames))):
        far = tested = 0
        for landmark, y, C in _placed(stream, k, run.online.T_world_body[k], P[k]):
            place = places.setdefault(landmark, _Place())
            known = place.before(k - WINDOW + 1)
            if known is not None:
                difference = y - known[0]
                tested += 1
                far += bool(difference @ np.linalg.solve(C + known[1], difference) > limit)
            if len(place.frames) < REMEMBERED:
                place.frames.append(k)
                place.y.append(y)
                place.C.append(C)
        window.append((far, tested))
        all_far, all_tested = (sum(each) for each in zip(*window, strict=True))
        if all_tested >= FEWEST and all_far > SHARE * all_tested:
            return Departure("MAP", k, float(all_far), SHARE * all_tested, all_tested, len(window))
    return None


def _placed(
    stream: MeasurementStream, k: int, T: FloatArray, P: FloatArray
) -> list[tuple[int, FloatArray, FloatArray]]:
    """The frame's landmarks as pose T with covariance P (p, p) places them: id, y, C."""
    by, frame = _sensor_that_places(stream.problem.sensor), stream.frames[k]
    seen = frame if by is stream.problem.sensor else frame.entries
    if seen is None or not seen.ids.size or not (np.isfinite(T).all() and np.isfinite(P).all()):
        return []
    y = by.invert(T, seen.z)
    H_pose, H_land = by.jacobians(T, y)
    if H_land.shape[1] != H_land.shape[2]:
        return []
    usable = np.flatnonzero(np.isfinite(y).all(axis=1) & np.isfinite(H_land).all(axis=(1, 2)))
    y, H_inv = y[usable], np.linalg.inv(H_land[usable])
    G = -H_inv @ H_pose[usable]
    R = seen.R[usable]
    C = G @ P @ np.swapaxes(G, 1, 2) + H_inv @ R @ np.swapaxes(H_inv, 1, 2)
    return list(zip(seen.ids[usable].tolist(), y, C, strict=True))


def _sensor_that_places(sensor: SensorModel) -> SensorModel:
    by: SensorModel | None = getattr(sensor, "entry_sensor", None)
    return by or sensor
