"""Robocentric EKF-SLAM: the map is kept where the robot sees it, and moved only after it was observed.

Castellanos, Martinez-Cantin, Tardós and Neira 2007, "Robocentric map joining": the state holds the pose at
which the robot set out, and all landmarks, in the robot's frame. A frame's increment joins the state, the
frame's observations correct it together with the map (the sensor standing at the increment, looking at
landmarks in the previous body frame), and only then is everything composed with the corrected increment.

========  ===========================================================================
symbol    meaning
========  ===========================================================================
e, r      error of T^-1 T_start and of the landmarks q = T^-1 l, see RobocentricChart
U, w, Q   the increment, its error U exp(w), and w's covariance
P         covariance of (e, r), or of (e, r, w) while a frame is taken in
M         (e, r, w) to (e, r) of the next frame
H, R, S   stacked Jacobian, measurement noise, innovation covariance
W, y      P H^T L^-T with S = L L^T, and the innovation
G, N      new landmarks' derivative by w, and their own noise
========  ===========================================================================
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Gt
from scipy.linalg import block_diag

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.filters.covariances.covariance import JointCovariance, block_diagonal, stacked
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance, Growth, Joining, Leaving
from slamcmp.backends.filters.error_state.charts import RobocentricChart
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf, NewLandmarks
from slamcmp.backends.filters.map_filter import Observed
from slamcmp.backends.robust import RobustKernel, robust_kernel
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
        robust, robust_width: see ../robust.py.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = self._robocentric = RobocentricChart(problem.sensor.space_dim, problem.T_world_body)
        super().__init__(
            problem,
            chart,
            LatestEstimate(),
            new_landmarks=new_landmarks,
            smooth=smooth,
            kernel=robust_kernel(robust, robust_width),
            covariance=IncrementCovariance,
        )
        self._P: IncrementCovariance
        self._U = np.eye(chart.n + 1)
        self._q = np.empty((0, chart.n))
        self._e, self._w = np.zeros(chart.p), np.zeros(chart.p)

    def construct(self, frame: Frame) -> Observed:
        """The frame's cost: prior, increment and observations, the increment being a part of the state."""
        self._begin(frame)
        self._U = np.array(frame.T_prev_body)
        self._q = transform(inverse(self._T), self._landmarks)
        self._e, self._w = np.zeros(self._chart.p), np.zeros(self._chart.p)
        # Frame 0 has the identity and no noise: an increment like any other.
        self._P.join(frame.Q)
        seen = self._sorted(frame)
        if self._join_first and seen.entries is not None:
            self._augment(seen.entries)
        return seen

    def marginalise(self, frame: Frame) -> None:
        """Move mean and covariance by the corrected increment, which leaves the state."""
        chart = self._robocentric
        T_before = chart.retract(self._T, self._q[:0], self._e)[0]
        self._T = T_before @ self._U
        self._landmarks = transform(T_before, self._q)
        B, C = chart.offsets(self._T, self._landmarks), chart.axes(self._T)
        # w is an error at the increment before its correction; the next frame sees it after.
        by_w = chart.from_body(self._T) @ right_jacobian(self._w)
        r_by_w = -(C.T @ B @ by_w).reshape(-1, chart.p)
        D = self._U[: chart.n, : chart.n].T
        self._P.leave(chart.transition(T_before, self._T), D, np.concatenate([by_w, r_by_w]))
        super().marginalise(frame)

    def _expected(self, numbers: IntArray) -> FloatArray:
        return self._sensor.predict(self._U, self._q[numbers])

    def _augment(self, entries: Entries) -> FloatArray:
        q = placed(self._entry_sensor, self._U, entries, self._P.frame)
        H_pose, H_land = self._entry_sensor.jacobians(self._U, q)
        H_inv = np.linalg.inv(H_land)
        G = -(H_inv @ H_pose).reshape(q.size, -1)
        self._enter(entries, q, G, block_diagonal(H_inv @ entries.R @ np.swapaxes(H_inv, 1, 2)))
        self._q = np.concatenate([self._q, q])
        return G

    def _correct(self, seen: Observed) -> None:
        q = self._q[seen.numbers]
        y = self._sensor.residual(seen.z, self._sensor.predict(self._U, q)).ravel()
        H = stacked(*self._sensor.jacobians(self._U, q))
        touched = self._P.touch(seen.numbers, self._q)
        dx = self._P.observe(touched, H, block_diagonal(seen.R), y)
        self._points = self._T @ self._U, transform(self._T, q), seen.numbers
        self._e, self._w, r = self._P.parted(dx)
        self._U = self._U @ exp(self._w)
        self._q = self._q + r.reshape(self._q.shape)


class IncrementCovariance(ErrorCovariance):
    """P of (e, r) between frames, and of (e, r, w, new r) while a frame is taken in."""

    def __init__(self, storage: JointCovariance, n: int) -> None:
        super().__init__(storage, n)
        self._at = storage.size
        """First state of w."""

    def join(self, Q: FloatArray) -> None:
        """The increment's error w, of covariance Q (p, p), becomes a part of the state."""
        self._at = self.size
        self.storage = JointCovariance(block_diag(self.dense(), Q))
        self._tell(Joining(Q, self._at))

    def grow(self, G: FloatArray, N: FloatArray) -> None:
        """New landmarks at the end: G (a, p) times w plus noise of covariance N (a, a)."""
        P = self.dense()
        by_all = np.zeros((len(G), self.size))
        by_all[:, self._at : self._at + G.shape[1]] = G
        rows = by_all @ P
        self.storage = JointCovariance(np.block([[P, rows.T], [rows, rows @ by_all.T + N]]))
        self._tell(Growth(G, N, self._at))

    def touch(self, numbers: IntArray, landmarks: FloatArray) -> IntArray:
        """States (c,) of w and of landmarks (m,) that were in the state when the frame began."""
        n = landmarks.shape[1]
        r = (n * numbers)[:, None] + self._pose_states.size + np.arange(n)
        return np.concatenate([self._at + self._pose_states, r.ravel()])

    def parted(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The parts of e, w and r of rows (states, …)."""
        p = self._pose_states.size
        after = self._at + p
        return rows[:p], rows[self._at : after], np.concatenate([rows[p : self._at], rows[after:]])

    def leave(self, F: FloatArray, D: FloatArray, W: FloatArray) -> None:
        """e becomes F e, each r becomes D r, both plus W (states, p) times w, which is marginalised."""

        p = len(F)

        def moved(rows: FloatArray) -> FloatArray:
            e, w, r = self.parted(rows)
            turned = (D @ r.reshape(-1, len(D), rows.shape[1])).reshape(r.shape)
            return np.concatenate([F @ e + W[:p] @ w, turned + W[p:] @ w])

        size = self.size
        P = moved(moved(self.dense()).T)
        self.storage = JointCovariance(P[:p, :p])
        self.storage.append(P[p:, :p], P[p:, p:])
        if self._listeners:
            self._tell(Leaving(moved(np.eye(size)), F, D, W))
