"""Where each known landmark should appear next, from odometry and its own sightings alone.

Each landmark is a small Kalman filter in the *body* frame. Odometry moves its mean and widens its
covariance, a sighting narrows it. Landmarks share no state, so one bad association spoils no other, and no
global pose is estimated: the test depends on no back end. Leaving out the information that other landmarks
carry only widens the gate.

========  ==========================================================
symbol    meaning
========  ==========================================================
q, C      landmark in the body frame (L, n) and covariance (L, n, n)
y, S      innovation (m, d) and its covariance (m, d, d)
========  ==========================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcmp.geometry import inverse, transform
from slamcmp.models.sensors import body_point_jacobians
from slamcmp.types import BoolArray, FloatArray, IntArray, SensorModel

ITERATIONS = 3
"""Of Gauss-Newton a detection; the third moves a landmark by less than its noise."""


@dataclass(frozen=True)
class Verdict:
    """Masks (m,) over the tested detections; one that is in neither passed."""

    rejected: BoolArray
    unconfirmed: BoolArray


class LandmarkTracks:
    """The Mahalanobis test against robot-centred predictions.

    Args:
        sensor: the landmark sensor.
        threshold: largest squared Mahalanobis distance that passes.
        restart_after: rejections in a row after which a track starts again from the detection at hand.
        min_sightings: 1 lets a first sighting pass untested; 2 holds it back until the next one agrees.
    """

    def __init__(self, sensor: SensorModel, threshold: float, restart_after: int, min_sightings: int) -> None:
        n = sensor.space_dim
        self._sensor = sensor
        self._threshold = threshold
        self._restart_after = restart_after
        self._min_sightings = min_sightings
        self._origin = np.eye(n + 1)
        self._row: dict[int, int] = {}
        self._q = np.empty((0, n))
        self._C = np.empty((0, n, n))
        self._rejections = np.empty(0, dtype=np.int64)
        self._sightings = np.empty(0, dtype=np.int64)

    def predict(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Carry every landmark into the new body frame, with the increment's uncertainty."""
        if not self._row:
            return
        T_body_prev = inverse(T_prev_body)
        self._q = transform(T_body_prev, self._q)
        H_pose, _ = body_point_jacobians(self._origin, self._q)
        R = T_body_prev[:-1, :-1]
        self._C = R @ self._C @ R.T + H_pose @ Q @ np.swapaxes(H_pose, -1, -2)

    def test(self, ids: IntArray, z: FloatArray, R: FloatArray) -> Verdict:
        """Test detections (m,), (m, d), (m, d, d) of one instant and learn from those that pass."""
        known = np.array([int(i) in self._row for i in ids], dtype=bool)
        rejected = np.zeros(ids.size, dtype=bool)
        unconfirmed = np.zeros(ids.size, dtype=bool)
        rows = np.array([self._row[int(i)] for i in ids[known]], dtype=np.int64)
        if rows.size:
            rejected[known] = self._correct(rows, z[known], R[known])
            stale = self._rejections[rows] >= self._restart_after
            self._start(rows[stale], z[known][stale], R[known][stale])
        new = np.flatnonzero(~known)
        if new.size:
            self._add(ids[new], z[new], R[new])
            unconfirmed[new] = self._min_sightings > 1
        return Verdict(rejected, unconfirmed)

    def _correct(self, rows: IntArray, z: FloatArray, R: FloatArray) -> BoolArray:
        q, C = self._q[rows], self._C[rows]
        q_new, C_new, distance = self._posterior(q, C, z, R)
        passed: BoolArray = distance <= self._threshold
        good = rows[passed]
        self._q[good], self._C[good] = q_new[passed], C_new[passed]
        self._sightings[good] += 1
        self._rejections[good] = 0
        bad = rows[~passed]
        self._rejections[bad] += 1
        # A landmark seen once and contradicted at once: nobody knows which of the two was the outlier.
        doubtful = self._sightings[bad] < self._min_sightings
        self._start(bad[doubtful], z[~passed][doubtful], R[~passed][doubtful])
        rejected: BoolArray = ~passed
        return rejected

    def _posterior(
        self, q: FloatArray, C: FloatArray, z: FloatArray, R: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean (m, n), covariance (m, n, n) and squared Mahalanobis distance (m,) after the detections.

        Gauss-Newton on the detection's and the prediction's squared deviations, begun where the detection
        says; the distance is what is left at their minimum, which is y^T S^-1 y where h is linear. A
        landmark that comes into view again is known to metres only: h linearised where it was expected
        would say little about where it is.
        """
        identity = np.eye(q.shape[1])
        at = self._sensor.invert(self._origin, z)
        for _ in range(ITERATIONS):
            z_at, _, H = self._sensor.linearise(self._origin, at)
            H_t = np.swapaxes(H, -1, -2)
            S_inv = np.linalg.inv(H @ C @ H_t + R)
            K = C @ H_t @ S_inv
            # From q, with h replaced by its tangent at the point of the last step.
            y = self._sensor.residual(z, z_at) - np.einsum("mij,mj->mi", H, q - at)
            at = q + np.einsum("mij,mj->mi", K, y)
        distance = np.einsum("mi,mij,mj->m", y, S_inv, y)
        # Joseph form keeps the small covariances symmetric and positive over thousands of sightings.
        A = identity - K @ H
        return at, A @ C @ np.swapaxes(A, -1, -2) + K @ R @ np.swapaxes(K, -1, -2), distance

    def _add(self, ids: IntArray, z: FloatArray, R: FloatArray) -> None:
        first = len(self._row)
        for offset, landmark in enumerate(ids):
            self._row[int(landmark)] = first + offset
        n = self._q.shape[1]
        self._q = np.concatenate([self._q, np.empty((ids.size, n))])
        self._C = np.concatenate([self._C, np.empty((ids.size, n, n))])
        self._rejections = np.concatenate([self._rejections, np.zeros(ids.size, dtype=np.int64)])
        self._sightings = np.concatenate([self._sightings, np.zeros(ids.size, dtype=np.int64)])
        self._start(np.arange(first, first + ids.size), z, R)

    def _start(self, rows: IntArray, z: FloatArray, R: FloatArray) -> None:
        if rows.size == 0:
            return
        q = self._sensor.invert(self._origin, z)
        _, H = self._sensor.jacobians(self._origin, q)
        J = np.linalg.inv(H)
        self._q[rows] = q
        self._C[rows] = J @ R @ np.swapaxes(J, -1, -2)
        self._rejections[rows] = 0
        self._sightings[rows] = 1
