"""Every point that is being followed: one row each, in arrays, with a small filter in the body frame.

As in the planar front end, each row is a Kalman filter of its own that odometry moves and widens and a
measurement narrows. Rows share no state, so that a wrong match spoils no other, and no pose is estimated.

========  =====================================================================
symbol    meaning
========  =====================================================================
q, C      point in the body frame (T, 3) [m] and its covariance (T, 3, 3)
y, S      innovation (m, d) and its covariance (m, d, d)
========  =====================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from slamcmp.frontend.vision.tracking.error_correlation import LAGS
from slamcmp.geometry import exp, inverse, transform
from slamcmp.models.camera import Camera, StereoCamera
from slamcmp.models.sensors import body_point_jacobians
from slamcmp.types import BoolArray, FloatArray, IntArray

VIEWS = 8
"""Sightings that a track remembers: its first one and the latest."""
_HERE = np.eye(4)


@dataclass
class TrackTable:
    """Tracks (T,), those with a place in space (``placed``) and those that are rays only."""

    id: IntArray
    """Of the landmark; -1 until the track is one."""
    descriptor: NDArray[np.uint8]
    """Of the last sighting, (T, 32)."""
    pixel: FloatArray
    """Of the last sighting, (T, 2)."""
    age: IntArray
    """Frames since the last sighting."""
    sightings: IntArray
    rejections: IntArray
    """In a row, by the Mahalanobis test."""
    placed: BoolArray
    q: FloatArray
    C: FloatArray
    view_pixel: FloatArray
    """(T, VIEWS, 2), the first sighting, then the latest ones up to the last."""
    view_back: IntArray
    """How many images ago each was taken, (T, VIEWS); -1 where there is none."""
    innovation: FloatArray
    """Of the latest sightings in a row over their deviations, newest first, (T, LAGS, 3); NaN: none."""

    @classmethod
    def empty(cls) -> TrackTable:
        """No tracks."""
        return cls._rays(np.empty((0, 32), np.uint8), np.empty((0, 2)))

    @classmethod
    def _rays(cls, descriptor: NDArray[np.uint8], pixel: FloatArray) -> TrackTable:
        count = len(pixel)
        view_pixel, view_back = np.zeros((count, VIEWS, 2)), np.full((count, VIEWS), -1)
        view_pixel[:, -1], view_back[:, -1] = pixel, 0
        return cls(
            np.full(count, -1),
            descriptor,
            pixel,
            np.zeros(count, np.int64),
            np.ones(count, np.int64),
            np.zeros(count, np.int64),
            np.zeros(count, dtype=bool),
            np.zeros((count, 3)),
            np.zeros((count, 3, 3)),
            view_pixel,
            view_back,
            np.full((count, LAGS, 3), np.nan),
        )

    def __len__(self) -> int:
        return self.id.size

    def keep(self, rows: BoolArray) -> None:
        """Forget all other rows."""
        for each in fields(self):
            setattr(self, each.name, getattr(self, each.name)[rows])

    def add(self, descriptor: NDArray[np.uint8], pixel: FloatArray) -> IntArray:
        """New tracks, seen once and without a place; their rows."""
        new = self._rays(descriptor, pixel)
        first = len(self)
        for each in fields(self):
            both = [getattr(self, each.name), getattr(new, each.name)]
            setattr(self, each.name, np.concatenate(both))
        return np.arange(first, len(self))

    def move(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """One frame on: carry the placed points into the new body frame, with the increment's doubt."""
        self.age += 1
        T_body_prev = inverse(T_prev_body)
        R, rows = T_body_prev[:3, :3], np.flatnonzero(self.placed)
        q = transform(T_body_prev, self.q[rows])
        J = self.by_motion(q)
        self.q[rows] = q
        self.C[rows] = R @ self.C[rows] @ R.T + J @ Q @ J.mT

    @staticmethod
    def by_motion(q: FloatArray) -> FloatArray:
        """Derivative (m, 3, 6) of points (m, 3) in the body frame by the pose's tangent: [hat(q), -I]."""
        J, _ = body_point_jacobians(_HERE, q)
        return J

    def correct_motion(self, xi: FloatArray, Q: FloatArray, Q_left: FloatArray) -> None:
        """The last increment, moved by with covariance Q, was off by ``xi``, known up to ``Q_left``."""
        rows = np.flatnonzero(self.placed)
        J = self.by_motion(self.q[rows])
        own = self.C[rows] - J @ Q @ J.mT
        T = exp(-xi)
        R, q = T[:3, :3], transform(T, self.q[rows])
        J = self.by_motion(q)
        C = R @ own @ R.T + J @ Q_left @ J.mT
        self.q[rows] = q
        self.C[rows] = 0.5 * (C + C.mT)

    def place(self, rows: IntArray, by: StereoCamera, z: FloatArray, R: FloatArray) -> None:
        """Put points where measurements (m, d) of a pair with covariances (m, d, d) say."""
        q = by.invert(_HERE, z)
        _, H = by.linearise_in_body(q)
        J = np.linalg.inv(H)
        self.q[rows] = q
        self.C[rows] = J @ R @ J.mT
        self.placed[rows] = True

    def predicted(self, rows: IntArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
        """Measurements (m, d) to expect and their covariances (m, d, d) by the points' own uncertainty."""
        with np.errstate(divide="ignore", invalid="ignore"):
            predicted, H = camera.linearise_in_body(self.q[rows])
            return predicted, H @ self.C[rows] @ H.mT

    def distances(self, rows: IntArray, camera: Camera, z: FloatArray, R: FloatArray) -> FloatArray:
        """Squared Mahalanobis distances (m,) of measurements (m, d) from what the rows predict."""
        if not rows.size:
            return np.empty(0)
        expected, S = self.predicted(rows, camera)
        y = camera.residual(z, expected)
        squared: FloatArray = (y * np.linalg.solve(S + R, y[:, :, None])[:, :, 0]).sum(axis=1)
        return squared

    def correct(self, rows: IntArray, camera: Camera, z: FloatArray, R: FloatArray) -> FloatArray:
        """The Kalman update of each row with its measurement; innovations over their deviations, (m, d)."""
        if not rows.size:
            return np.empty((0, camera.dim))
        predicted, H = camera.linearise_in_body(self.q[rows])
        C = self.C[rows]
        C_Ht = C @ H.mT
        S = H @ C @ H.mT + R
        K = C_Ht @ np.linalg.inv(S)
        y = camera.residual(z, predicted)
        self.q[rows] += (K @ y[:, :, None])[:, :, 0]
        # Joseph form: symmetric and positive over thousands of sightings.
        A = np.eye(3) - K @ H
        self.C[rows] = A @ C @ A.mT + K @ R @ K.mT
        over: FloatArray = y / np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        return over

    def note_innovations(self, rows: IntArray, latest: FloatArray) -> FloatArray:
        """Put innovations (m, d) on top of the rows' lists; those before them, (m, LAGS, d).

        A track that was out of sight in between begins anew. To be called before :meth:`see`.
        """
        lists = self.innovation[rows]
        lists[self.age[rows] > 1] = np.nan
        d = latest.shape[1]
        self.innovation[rows, 1:] = lists[:, :-1]
        self.innovation[rows, 0] = np.nan
        self.innovation[rows, 0, :d] = latest
        return lists[:, :, :d]

    def see(self, rows: IntArray, descriptor: NDArray[np.uint8], pixel: FloatArray) -> None:
        """Note a sighting of each row in the present image."""
        self.descriptor[rows], self.pixel[rows] = descriptor, pixel
        self.age[rows], self.rejections[rows] = 0, 0
        self.sightings[rows] += 1
        # Of a full list the second goes: the oldest has the most parallax.
        full = self.view_back[rows, 0] >= 0
        for views in (self.view_pixel, self.view_back):
            oldest = views[rows, 0]
            views[rows, :-1] = views[rows, 1:]
            views[rows[full], 0] = oldest[full]
        self.view_pixel[rows, -1], self.view_back[rows, -1] = pixel, 0
