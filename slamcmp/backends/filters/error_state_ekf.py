"""One EKF-SLAM for every chart and every linearisation policy.

The frame's steps are those of ``ekf_slam``: predict, let new landmarks join, correct with one stacked update.
The covariance lives in the chart (charts.py); Jacobians are taken where the policy says
(linearisation.py); the innovation is always the newest mean's. What leaves the filter is in the body tangent
and world axes. With ``smooth`` every step is kept and ``trajectory()`` is the filter's RTS smoother
(rts_smoother.py), its fair partner in hindsight.

========  ===================================================================
symbol    meaning
========  ===================================================================
x         mean: T_world_body (n+1, n+1) and landmarks (L, n)
P         joint covariance in the chart, pose first
A, B, C   the chart's maps, see charts.py
F, Q      transition of the pose's error, and the increment's noise in the body tangent
z, y      measurement and innovation, stacked (k d,)
H, R, S   stacked Jacobian in the chart, measurement noise, innovation covariance
W, e      P H^T L^-T and L^-1 y, with S = L L^T
G, N      new landmarks' derivative by the pose's error, and their own noise
========  ===================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.filters.covariances.covariance import JointCovariance, block_diagonal, stacked
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance
from slamcmp.backends.filters.error_state.charts import Chart
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state.unanchored import square_root
from slamcmp.backends.filters.map_filter import LinearisingFilter, Observed, sandwich
from slamcmp.backends.filters.rts_smoother import History
from slamcmp.backends.robust import Kernel
from slamcmp.types import BoolArray, FloatArray, Frame, IntArray, Problem, SensorModel, Trajectory

NewLandmarks = Literal["join_first", "update_first"]
"""``join_first`` puts new landmarks into the state before the update, linearised at the predicted pose;
``update_first`` corrects with the known landmarks first and initialises new ones from the corrected pose."""


class ErrorStateEkf(LinearisingFilter):
    """EKF-SLAM in a chart, linearised by a policy.

    Args:
        problem: prior and sensor.
        chart: what an error vector means.
        policy: where Jacobians are taken; other than at the latest estimate only in the world chart.
        new_landmarks: see :data:`NewLandmarks`.
        smooth: keep the history and offer ``trajectory()``.
        kernel: of the observations; None: they are quadratic. With one, a landmark whose second sighting
            contradicts its first starts anew (doubtful.py).
        covariance: the verbs on P.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite, most landmarks that a
            camera sees are behind it, or the policy's points are far from the estimates.
    """

    trajectory: Callable[[], Trajectory]
    """Every pose with hindsight; exists only with ``smooth``, so that a plain filter is no smoother."""

    def __init__(
        self,
        problem: Problem,
        chart: Chart,
        policy: LatestEstimate,
        *,
        new_landmarks: NewLandmarks,
        smooth: bool,
        kernel: Kernel | None = None,
        covariance: type[ErrorCovariance] = ErrorCovariance,
    ) -> None:
        T = problem.T_world_body
        P = JointCovariance(sandwich(chart.from_body(T), problem.P))
        super().__init__(problem, chart, covariance(P, chart.n), kernel)
        self._policy = policy
        self._join_first = new_landmarks == "join_first"
        self.history: History | None = None
        if smooth:
            self.history = self._P.add_listener(History(chart.p, chart.n))
            self.trajectory = self._smoothed

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        if self._loops.take(frame):
            return
        seen = self.construct(frame)
        self.solve(seen)
        self.marginalise(frame)

    def construct(self, frame: Frame) -> Observed:
        """The frame's cost: the prior on pose and map carried over the odometry, and what was observed.

        The old pose leaves here already, for only the odometry refers to it (error_covariance.py).
        """
        self._begin(frame)
        seen = self._sorted(frame)
        if frame.k > 0:
            self._predict(frame, seen.numbers)
        if self._join_first and seen.entries is not None:
            self._augment(seen.entries)
        return seen

    def solve(self, seen: Observed) -> None:
        """One Gauss–Newton step on it, in covariance form."""
        if seen.numbers.size:
            self._correct(self._visible(seen))
        if not self._join_first and seen.entries is not None:
            self._augment(seen.entries)

    def marginalise(self, frame: Frame) -> None:
        """The posterior of pose and map is the next frame's prior."""
        self._P.end_frame(frame.t, self._T)

    def _keep(self, stays: BoolArray) -> None:
        super()._keep(stays)
        self._policy.keep(stays)

    def _predict(self, frame: Frame, seen: IntArray) -> None:
        """Move to the frame's pose; ``seen`` are the numbers of the known landmarks that it observes."""
        chart = self._chart
        T_after = self._T @ frame.T_prev_body
        T_from, T_to = self._policy.motion(frame.k, self._T, T_after, seen, self._landmarks[seen])
        F = chart.transition(T_from, T_to)
        noise_map = chart.from_body(T_to)
        C_to = chart.axes(T_to)
        D = None if C_to is None else frame.T_prev_body[: chart.n, : chart.n].T
        B = chart.offsets(T_to, self._landmarks)
        if B is None:
            self._P.move(F, D, sandwich(noise_map, frame.Q))
        else:
            self._P.move(F, D, W=self._shaken(frame.Q, noise_map, B, C_to))
        self._T = T_after

    def _shaken(
        self, Q: FloatArray, noise_map: FloatArray | None, B: FloatArray, C: FloatArray | None
    ) -> FloatArray:
        """Square root (states, p) of the step's noise where it reaches the landmarks' errors too.

        A landmark does not move with the robot, 0 = B e + C r, so what shakes e shakes r by -C^T B.
        """
        root = square_root(Q)
        if noise_map is not None:
            root = noise_map @ root
        on_landmarks = -(B if C is None else C.T @ B) @ root
        return np.concatenate([root, on_landmarks.reshape(-1, root.shape[1])])

    def _visible(self, seen: Observed) -> Observed:
        """Without the landmarks behind a camera."""
        return self._with_image(seen, self._expected(seen.numbers)) if self._has_blind_side else seen

    def _expected(self, numbers: IntArray) -> FloatArray:
        return self._sensor.predict(self._T, self._landmarks[numbers])

    def _augment(self, entries: Entries) -> FloatArray:
        """New landmarks at their inverse observation, correlated with everything known; returns G (a, p)."""
        positions = placed(self._entry_sensor, self._T, entries, self._P.frame)
        T_at, landmarks_at = self._policy.new(self._T, entries.ids, positions)
        # 0 = H_pose e + H_land r - v, solved for r: no sensor needs a Jacobian of its inverse.
        H_pose, H_land = self._jacobians(self._entry_sensor, T_at, landmarks_at)
        H_inv = np.linalg.inv(H_land)
        G = -(H_inv @ H_pose).reshape(-1, self._chart.p)
        self._enter(entries, positions, G, block_diagonal(H_inv @ entries.R @ np.swapaxes(H_inv, 1, 2)))
        return G

    def _correct(self, seen: Observed) -> None:
        landmarks = self._landmarks[seen.numbers]
        y = self._sensor.residual(seen.z, self._sensor.predict(self._T, landmarks)).ravel()
        T_at, landmarks_at = at = self._policy.known(self._T, seen.numbers, landmarks)
        self._policy.require_near(self._P.frame, self._T, landmarks, at)
        self._points = T_at, landmarks_at, seen.numbers
        H = stacked(*self._jacobians(self._sensor, T_at, landmarks_at))
        touched = self._P.touch(seen.numbers, self._landmarks)
        dx = self._P.observe(touched, H, block_diagonal(seen.R), y)
        self._T, self._landmarks = self._chart.retract(self._T, self._landmarks, dx)

    def _jacobians(
        self, sensor: SensorModel, T: FloatArray, landmarks: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The sensor's Jacobians in the chart, (m, d, p) and (m, d, n)."""
        H_pose, H_land = sensor.jacobians(T, landmarks)
        A, B, C = self._chart.to_body(T), self._chart.offsets(T, landmarks), self._chart.axes(T)
        if A is not None:
            H_pose = H_pose @ A
        if B is not None:
            H_pose = H_pose + H_land @ B
        return H_pose, H_land if C is None else H_land @ C

    def _smoothed(self) -> Trajectory:
        """Every pose with hindsight (RTS), each about the filter's mean of its own frame."""
        assert self.history is not None
        frames, errors, P = self.history.smoothed_errors()
        none = np.empty((0, self._chart.n))
        poses = [
            self._chart.retract(frame.mean, none, error)[0]
            for frame, error in zip(frames, errors, strict=True)
        ]
        covariances = [sandwich(self._chart.to_body(T), block) for T, block in zip(poses, P, strict=True)]
        return Trajectory(np.array([frame.t for frame in frames]), np.array(poses), np.array(covariances))
