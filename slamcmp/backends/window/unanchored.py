"""What a window's linear system would claim about the last pose, had nothing been known at the start.

As ../unanchored.py says; here the marginal prior is carried on a second time, without
the prior on the first pose, linearised as the real one is.

========  =====================================================================
symbol    meaning
========  =====================================================================
R         rows of the square-root information, on a pose, then landmarks
J         derivative of one pose error by another, (p, p)
========  =====================================================================
"""

from __future__ import annotations

import numpy as np

from slamcmp.backends.sights import Measurements
from slamcmp.backends.unanchored import last_block, triangular
from slamcmp.backends.window.cost import LinearCost, ObservationTerms
from slamcmp.backends.window.marginalisation import Prior
from slamcmp.backends.window.window import WindowListener
from slamcmp.types import FloatArray, IntArray


class UnanchoredWindow(WindowListener):
    """A window's marginal prior without its start, driven by the window's own linear system.

    Args:
        p: dimension of the pose's error.
    """

    def __init__(self, p: int) -> None:
        self._p = p
        self._prior: FloatArray = np.empty((0, p))
        self._linear = self._prior
        self._squares = np.zeros(p)

    def linearised(self, prior: Prior, T: FloatArray) -> None:
        """Take the prior to the pose's error at T."""
        self._linear = _by_pose(self._prior, prior.jacobian(T))

    def turned(self, J: FloatArray) -> None:
        """Take what ``linearised`` left to the pose's error of which its own is J (p, p) times."""
        self._linear = _by_pose(self._linear, J)

    def marginalised(self, cost: LinearCost, measurements: Measurements) -> None:
        """Turn the oldest pose's rows into a prior on the next."""
        here = slice(measurements.from_first_pose())
        self._squares += (cost.observations.H_pose[here] ** 2).sum(axis=(0, 1))
        rows = self._of_pose(self._linear, cost.observations.of(here), measurements.landmark_of[here])
        self._prior = self._linear = _passed_on(rows, cost.odometry.A_prev[0], cost.odometry.A_next[0])

    def dropped(self, landmarks: IntArray, n: int) -> None:
        """Marginalise the landmarks out of the prior."""
        p, R = self._p, self._linear
        known = landmarks[p + n * (landmarks + 1) <= R.shape[1]]
        if not known.size:
            return
        states = (p + n * known[:, None] + np.arange(n)).ravel()
        keep = np.setdiff1d(np.arange(R.shape[1]), states)
        R = triangular(R[:, np.concatenate([states, keep])])
        self._prior = self._linear = R[states.size :, states.size :]

    def told(self, cost: LinearCost, measurements: Measurements) -> tuple[FloatArray, FloatArray]:
        """Root (p, p) of the information on the last pose, all else eliminated, and its scale (p,)."""
        R, odometry = self._linear, cost.odometry
        last = len(odometry.b)
        starts = np.searchsorted(measurements.pose_of, np.arange(last + 2))
        for pose in range(last + 1):
            here = slice(starts[pose], starts[pose + 1])
            R = self._of_pose(R, cost.observations.of(here), measurements.landmark_of[here])
            if pose < last:
                R = _passed_on(R, odometry.A_prev[pose], odometry.A_next[pose])
        squares = self._squares + (cost.observations.H_pose**2).sum(axis=(0, 1))
        p = self._p
        return last_block(triangular(np.concatenate([R[:, p:], R[:, :p]], axis=1)), p), np.sqrt(squares)

    def _of_pose(self, R: FloatArray, observations: ObservationTerms, numbers: IntArray) -> FloatArray:
        """The rows R on a pose and landmarks, with those of its observations, of landmarks (m,), below."""
        m, d, p = observations.H_pose.shape
        n = observations.H_land.shape[2]
        size = max(R.shape[1], p + n * (int(numbers.max(initial=-1)) + 1))
        rows = np.zeros((m, d, size))
        rows[:, :, :p] = observations.H_pose
        columns = p + n * numbers[:, None] + np.arange(n)
        rows[np.arange(m)[:, None, None], np.arange(d)[:, None], columns[:, None, :]] = observations.H_land
        return np.concatenate([np.pad(R, ((0, 0), (0, size - R.shape[1]))), rows.reshape(m * d, size)])


def _by_pose(R: FloatArray, J: FloatArray) -> FloatArray:
    p = len(J)
    return np.concatenate([R[:, :p] @ J, R[:, p:]], axis=1)


def _passed_on(rows: FloatArray, A_prev: FloatArray, A_next: FloatArray) -> FloatArray:
    """Rows on (pose, landmarks) and an increment's, as rows on (next pose, landmarks)."""
    p = len(A_prev)
    increment = np.concatenate([A_prev, np.zeros((p, rows.shape[1] - p)), A_next], axis=1)
    R = triangular(np.concatenate([np.pad(rows, ((0, 0), (0, p))), increment]))[p:, p:]
    return np.concatenate([R[:, -p:], R[:, :-p]], axis=1)
