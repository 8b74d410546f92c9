"""Landmarks that one measurement has placed, and no second one confirmed: what a robust estimator does then.

A landmark starts where its first sighting puts it, and fits that one exactly: no kernel can doubt it. If it
was an outlier, all later sightings contradict the map, and a kernel would reject them for ever. So as long as
a landmark rests on a single sighting, the next one is tested against it; where they contradict each other,
nobody knows which of the two is wrong, and the landmark starts anew from the later one.

The test needs no estimate of the pose: the landmark is carried in the body frame by odometry alone, as the
front end's tracks are (frontend/landmark_tracks.py). So all robust back ends, filters and smoothers, start
the same landmarks anew at the same frames. Two ghosts that agree are a landmark, here as for anybody.

========  ==============================================
symbol    meaning
========  ==============================================
q, C      landmark in the body frame (n,), covariance (n, n)
========  ==============================================
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np
from scipy.special import chdtri

from slamcmp.backends.entries import places_by_itself
from slamcmp.geometry import inverse, transform
from slamcmp.models.sensors import body_point_jacobians
from slamcmp.types import FloatArray, Frame, SensorModel

AGREE = 0.9999
"""Probability with which two right sightings of one landmark agree."""


class DoubtfulLandmarks:
    """Who rests on one sighting.

    Args:
        sensor: one that places a landmark by a measurement; with any other nobody is ever doubted, for there
            is no second placing to start from.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._sensor = sensor
        self._active = places_by_itself(sensor)
        self._origin = np.eye(sensor.space_dim + 1)
        self._limit = float(chdtri(sensor.space_dim, 1.0 - AGREE))
        self._placed: dict[int, tuple[FloatArray, FloatArray]] = {}

    def contradicted(self, frame: Frame, known: Container[int]) -> list[int]:
        """The landmarks that must start anew from the frame's measurement; call it once a frame, in order.

        Args:
            frame: odometry and measurements.
            known: ids of the landmarks that the estimator has; others start with this frame.
        """
        if not self._active:
            return []
        if frame.k > 0 and self._placed:
            self._move(frame)
        again = []
        for landmark, z, R in zip(frame.ids.tolist(), frame.z, frame.R, strict=True):
            if landmark not in known:
                self._placed[landmark] = self._place(z, R)
            elif landmark in self._placed:
                q, C = self._place(z, R)
                q_before, C_before = self._placed.pop(landmark)
                difference = q - q_before
                if difference @ np.linalg.solve(C + C_before, difference) > self._limit:
                    self._placed[landmark] = q, C
                    again.append(landmark)
        return again

    def _move(self, frame: Frame) -> None:
        """Carry every doubtful landmark into the frame's body axes."""
        T_body_prev = inverse(frame.T_prev_body)
        turn = T_body_prev[:-1, :-1]
        for landmark, (q, C) in self._placed.items():
            moved = transform(T_body_prev, q)
            H_pose, _ = body_point_jacobians(self._origin, moved)
            self._placed[landmark] = moved, turn @ C @ turn.T + H_pose @ frame.Q @ H_pose.T

    def _place(self, z: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where a measurement puts the landmark in the body frame, with its covariance."""
        q = self._sensor.invert(self._origin, z)
        _, H = self._sensor.jacobians(self._origin, q)
        J = np.linalg.inv(H)
        return q, J @ R @ J.T
