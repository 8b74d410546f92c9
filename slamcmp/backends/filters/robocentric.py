"""Robocentric EKF-SLAM: the map is kept where the robot sees it, and moved only after it was observed.

Castellanos, Martinez-Cantin, Tardós and Neira 2007, "Robocentric map joining": the state holds the world's
own pose and all landmarks in the robot's frame. A frame's increment joins the state, the frame's observations
correct it together with the map (the sensor standing at the increment, looking at landmarks in the previous
body frame), and only then is everything composed with the corrected increment.

========  ===========================================================================
symbol    meaning
========  ===========================================================================
e, r      error of T^-1 and of the landmarks q = T^-1 l, see RobocentricChart
U, w, Q   the increment, its error U exp(w), and w's covariance
P         covariance of (e, r), or of (e, r, w) while a frame is taken in
M         (e, r, w) to (e, r) of the next frame
H, R, S   stacked Jacobian, measurement noise, innovation covariance
W, y      P H^T L^-T with S = L L^T, and the innovation
G, N      new landmarks' derivative by w, and their own noise
========  ===========================================================================
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.filters.charts import RobocentricChart
from slamcmp.backends.filters.covariance import JointCovariance, block_diagonal
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf, NewLandmarks, stacked
from slamcmp.backends.filters.linearisation import LatestEstimate
from slamcmp.backends.filters.rts_smoother import FrameEnd, Growth, Remap
from slamcmp.backends.filters.unanchored import square_root
from slamcmp.geometry import exp, inverse, right_jacobian, transform
from slamcmp.registry import back_ends
from slamcmp.types import FloatArray, Frame, IntArray, Problem


@back_ends.register("ekf_robocentric")
class RobocentricEkf(ErrorStateEkf):
    """EKF-SLAM in the robot's frame: correct the increment first, then compose (Castellanos et al. 2007).

    Args:
        problem: prior and sensor.
        new_landmarks: see error_state_ekf.py.
        smooth: keep the history and offer ``trajectory()``.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self, problem: Problem, *, new_landmarks: NewLandmarks = "join_first", smooth: bool = False
    ) -> None:
        chart = self._robocentric = RobocentricChart(problem.sensor.space_dim)
        super().__init__(problem, chart, LatestEstimate(), new_landmarks=new_landmarks, smooth=smooth)
        self._U = np.eye(chart.n + 1)
        self._q = np.empty((0, chart.n))
        self._e, self._w = np.zeros(chart.p), np.zeros(chart.p)
        self._w_at = chart.p
        self._w_root = np.zeros((chart.p, chart.p))

    def update(self, frame: Frame) -> None:
        """Let the increment join the state, take in the observations, then move to the frame's pose."""
        p = self._chart.p
        self._k = frame.k
        self._nis, self._nis_dof, self._dropped = 0.0, 0, 0
        self._points = None
        self._U = np.array(frame.T_prev_body)
        self._q = transform(inverse(self._T), self._landmarks)
        self._e, self._w = np.zeros(p), np.zeros(p)
        self._w_at = self._P.size
        # Frame 0 has the identity and no noise: an increment like any other.
        self._P = JointCovariance(block_diag(self._P.dense(), frame.Q))
        if self.history is not None:
            self.history.events.append(Remap(np.eye(self._w_at + p, self._w_at)))
        if self._unanchored is not None:
            self._w_root = square_root(frame.Q)
            self._unanchored.shake(p)
        numbers = np.array([self._number.get(name, -1) for name in frame.ids.tolist()], dtype=np.int64)
        self._observe(frame, numbers)
        self._compose()
        if self.history is not None:
            rows = self._P.columns(self._pose_states, self._chart.n).T.copy()
            self.history.events.append(FrameEnd(frame.t, self._T, rows))

    def _expected(self, numbers: IntArray) -> FloatArray:
        return self._sensor.predict(self._U, self._q[numbers])

    def _augment(self, entries: Entries) -> FloatArray:
        q = placed(self._entry_sensor, self._U, entries, self._k)
        H_pose, H_land = self._entry_sensor.jacobians(self._U, q)
        H_inv = np.linalg.inv(H_land)
        w_states = slice(self._w_at, self._w_at + self._chart.p)
        G = np.zeros((q.size, self._P.size))
        G[:, w_states] = -(H_inv @ H_pose).reshape(q.size, -1)
        P = self._P.dense()
        rows = G @ P
        N = block_diagonal(H_inv @ entries.R @ np.swapaxes(H_inv, 1, 2))
        self._P = JointCovariance(np.block([[P, rows.T], [rows, rows @ G.T + N]]))
        if self.history is not None:
            self.history.events.append(Growth(np.zeros((q.size, self._chart.p))))
            M = np.eye(self._P.size)
            M[-q.size :, w_states] = G[:, w_states]
            self.history.events.append(Remap(M))
        if self._unanchored is not None:
            self._unanchored.grow(np.zeros((q.size, self._chart.p)), N, G[:, w_states] @ self._w_root)
        count = len(self._number)
        self._q = np.concatenate([self._q, q])
        for offset, landmark in enumerate(entries.ids.tolist()):
            self._number[landmark] = count + offset
        return G

    def _correct(self, numbers: IntArray, z: FloatArray, R: FloatArray) -> None:
        p, n = self._chart.p, self._chart.n
        seen = self._q[numbers]
        y = self._sensor.residual(z, self._sensor.predict(self._U, seen)).ravel()
        H = stacked(*self._sensor.jacobians(self._U, seen))
        touched = np.concatenate(
            [self._w_at + self._pose_states, (numbers[:, None] * n + self._axes).ravel()]
        )
        dx = self._condition(touched, y, H, block_diagonal(R))
        self._points = self._T @ self._U, transform(self._T, seen), numbers
        after_w = self._w_at + p
        self._e, self._w = dx[:p], dx[self._w_at : after_w]
        self._U = self._U @ exp(self._w)
        self._q = self._q + np.concatenate([dx[p : self._w_at], dx[after_w:]]).reshape(-1, n)

    def _note_observation(self, touched: IntArray, H: FloatArray, R: FloatArray) -> None:
        assert self._unanchored is not None
        p = self._chart.p
        land = touched[p:]
        land = np.where(land < self._w_at, land, land - p)
        self._unanchored.observe(land, H[:, p:], R, H[:, :p] @ self._w_root)

    def _compose(self) -> None:
        """Move mean and covariance by the corrected increment, which leaves the state."""
        chart, p = self._robocentric, self._chart.p
        T_before = chart.retract(self._T, self._q[:0], self._e)[0]
        self._T = T_before @ self._U
        self._landmarks = transform(T_before, self._q)
        noise_map, F = chart.from_body(self._T), chart.transition(T_before, self._T)
        B, C = chart.offsets(self._T, self._landmarks), chart.axes(self._T)
        # w is an error at the increment before its correction; the next frame sees it after.
        by_w = noise_map @ right_jacobian(self._w)
        r_by_w = -(C.T @ B @ by_w).reshape(-1, p)
        D = self._U[: chart.n, : chart.n].T

        def moved(rows: FloatArray) -> FloatArray:
            after_w = self._w_at + p
            w = rows[self._w_at : after_w]
            r = np.concatenate([rows[p : self._w_at], rows[after_w:]])
            turned = (D @ r.reshape(-1, chart.n, rows.shape[1])).reshape(r.shape)
            return np.concatenate([F @ rows[:p] + by_w @ w, turned + r_by_w @ w])

        P = moved(moved(self._P.dense()).T)
        self._P = JointCovariance(P[:p, :p])
        self._P.append(P[p:, :p], P[p:, p:])
        if self.history is not None:
            self.history.events.append(Remap(moved(np.eye(2 * p + self._q.size))))
        if self._unanchored is not None:
            self._unanchored.move(F, D, np.concatenate([by_w, r_by_w]) @ self._w_root)
