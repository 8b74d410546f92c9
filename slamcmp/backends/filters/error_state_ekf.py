"""One EKF-SLAM for every chart and every linearisation policy.

The frame's steps are those of ``ekf_slam``: predict, let new landmarks join, correct with one stacked update.
The covariance lives in the chart (ekf_charts.py); Jacobians are taken where the policy says
(linearisation.py); the innovation is always the newest mean's. What leaves the filter is in the body tangent
and world axes. With ``smooth`` every step is kept and ``trajectory()`` is the filter's RTS smoother
(filter_history.py), its fair partner in hindsight.

========  ===================================================================
symbol    meaning
========  ===================================================================
x         mean: T_world_body (n+1, n+1) and landmarks (L, n)
P         joint covariance in the chart, pose first
A, B, C   the chart's maps, see ekf_charts.py
F, Q      transition of the pose's error, and the increment's noise in the body tangent
z, y      measurement and innovation, stacked (k d,)
H, R, S   stacked Jacobian in the chart, measurement noise, innovation covariance
W, e      P H^T L^-T and L^-1 y, with S = L L^T
G, N      new landmarks' derivative by the pose's error, and their own noise
========  ===================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.backends.entries import Entries, entering, has_blind_side, placed, with_image
from slamcmp.backends.filters.charts import Chart
from slamcmp.backends.filters.covariance import JointCovariance, block_diagonal
from slamcmp.backends.filters.linearisation import LatestEstimate
from slamcmp.backends.filters.rts_smoother import Correction, FrameEnd, Growth, History, Step
from slamcmp.backends.filters.unanchored import Linearisation, UnanchoredFilter, square_root
from slamcmp.errors import DivergedError
from slamcmp.models.sensors import entry_sensor
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Landmarks, Problem, SensorModel, Trajectory

NewLandmarks = Literal["join_first", "update_first"]
"""``join_first`` puts new landmarks into the state before the update, linearised at the predicted pose;
``update_first`` corrects with the known landmarks first and initialises new ones from the corrected pose."""


class ErrorStateEkf:
    """EKF-SLAM in a chart, linearised by a policy.

    Args:
        problem: prior and sensor.
        chart: what an error vector means.
        policy: where Jacobians are taken; other than at the latest estimate only in the world chart.
        new_landmarks: see :data:`NewLandmarks`.
        smooth: keep the history and offer ``trajectory()``.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite, or most landmarks
            that a camera sees are behind it.
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
    ) -> None:
        self._sensor, self._entry_sensor = problem.sensor, entry_sensor(problem.sensor)
        self._has_blind_side = has_blind_side(problem.sensor)
        self._chart, self._policy = chart, policy
        self._join_first = new_landmarks == "join_first"
        self._T = np.array(problem.T_world_body)
        self._P = JointCovariance(sandwich(chart.from_body(self._T), problem.P))
        self._pose_states = np.arange(chart.p)
        self._axes = chart.p + np.arange(chart.n)
        self._landmarks = np.empty((0, chart.n))
        self._number: dict[int, int] = {}
        self._k = -1
        self._nis, self._nis_dof, self._dropped = 0.0, 0, 0
        self.history: History | None = None
        if smooth:
            self.history = History(chart.p, chart.n)
            self.trajectory = self._smoothed
        self._unanchored: UnanchoredFilter | None = None
        self._points: tuple[FloatArray, FloatArray, IntArray] | None = None

    def update(self, frame: Frame) -> None:
        """Predict to the frame's pose, then take in its observations."""
        self._k = frame.k
        self._nis, self._nis_dof, self._dropped = 0.0, 0, 0
        self._points = None
        numbers = np.array(
            [self._number.get(landmark, -1) for landmark in frame.ids.tolist()], dtype=np.int64
        )
        if frame.k > 0:
            self._predict(frame, numbers[numbers >= 0])
        self._observe(frame, numbers)
        if self.history is not None:
            rows = self._P.columns(self._pose_states, self._chart.n).T.copy()
            self.history.events.append(FrameEnd(frame.t, self._T, rows))

    def estimate(self) -> Estimate:
        """The current pose and its covariance."""
        return Estimate(self._T, sandwich(self._chart.to_body(self._T), self._P.pose_block()))

    def landmarks(self) -> Landmarks:
        """Every landmark ever seen, in the order of first sight."""
        count, n, p = len(self._number), self._chart.n, self._chart.p
        ids = np.fromiter(self._number, dtype=np.int64, count=count)
        blocks = sandwich(self._chart.axes(self._T), self._P.diagonal_blocks(n))
        B = self._chart.offsets(self._T, self._landmarks)
        if B is not None:
            rows = self._P.columns(self._pose_states, n)[p:].reshape(count, n, p)
            C = self._chart.axes(self._T)
            across = (rows if C is None else C @ rows) @ np.swapaxes(B, 1, 2)
            blocks = blocks + across + np.swapaxes(across, 1, 2)
            blocks += B @ self._P.pose_block() @ np.swapaxes(B, 1, 2)
        return Landmarks(ids, self._landmarks, blocks)

    def joint_covariance(self) -> FloatArray:
        """P of pose (body tangent) and landmarks (world axes), (p + n L, p + n L)."""
        count, n, p = len(self._number), self._chart.n, self._chart.p
        A, C = self._chart.to_body(self._T), self._chart.axes(self._T)
        B = self._chart.offsets(self._T, self._landmarks)
        to_border = np.eye(p + n * count)
        if A is not None:
            to_border[:p, :p] = A
        if C is not None:
            to_border[p:, p:] = block_diagonal(np.broadcast_to(C, (count, n, n)))
        if B is not None:
            to_border[p:, :p] = B.reshape(-1, p)
        return sandwich(to_border, self._P.dense())

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, landmarks, and how many of the frame's
        measurements were dropped (entries.py)."""
        return {
            "nis": self._nis if self._nis_dof else float("nan"),
            "nis_dof": self._nis_dof,
            "landmarks": len(self._number),
            "dropped": self._dropped,
        }

    def record_linearisation(self) -> None:
        """Keep what :meth:`linearisation` needs, from the first frame on."""
        self._unanchored = UnanchoredFilter(self._chart.p)

    def linearisation(self) -> Linearisation:
        """What the filter's own matrices claim about its pose, and where its last Jacobians were taken."""
        assert self._unanchored is not None
        root, scale = self._unanchored.told()
        to_chart = self._chart.from_body(self._T)
        if to_chart is not None:
            root = root @ to_chart
            scale = np.linalg.norm(scale[:, None] * to_chart, axis=0)
        if self._points is None:
            return Linearisation(root, scale)
        T_at, landmarks_at, numbers = self._points
        return Linearisation(root, scale, T_at, landmarks_at, self._landmarks[numbers])

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
        if D is not None:
            self._P.turn_landmarks(D)
        W_t = None if B is None else self._shaken(frame.Q, noise_map, B, C_to)
        if W_t is None:
            self._P.propagate(self._identity if F is None else F, sandwich(noise_map, frame.Q))
        else:
            if F is not None:
                self._P.propagate(F, np.zeros_like(frame.Q))
            self._P.inflate(W_t)
        self._T = T_after
        if self.history is not None:
            self.history.events.append(Step(F, D))
        if self._unanchored is not None:
            W = square_root(sandwich(noise_map, frame.Q)) if W_t is None else W_t.T
            self._unanchored.move(F, D, W)

    def _shaken(
        self, Q: FloatArray, noise_map: FloatArray | None, B: FloatArray, C: FloatArray | None
    ) -> FloatArray:
        """Square root (p, states) of the step's noise where it reaches the landmarks' errors too.

        A landmark does not move with the robot, 0 = B e + C r, so what shakes e shakes r by -C^T B.
        """
        root = square_root(Q)
        if noise_map is not None:
            root = noise_map @ root
        on_landmarks = -(B if C is None else C.T @ B) @ root
        return np.concatenate([root, on_landmarks.reshape(-1, root.shape[1])]).T

    def _observe(self, frame: Frame, numbers: IntArray) -> None:
        known = numbers >= 0
        entries = entering(frame, ~known, self._sensor)
        self._dropped = entries.dropped
        if self._join_first and entries.ids.size:
            self._augment(entries)
        if known.any():
            self._correct(*self._in_front(numbers[known], frame.z[known], frame.R[known]))
        if not self._join_first and entries.ids.size:
            self._augment(entries)

    def _in_front(
        self, numbers: IntArray, z: FloatArray, R: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """The observations without those that a camera cannot have made if the estimate is right.

        Raises:
            DivergedError: they are most.
        """
        if not self._has_blind_side:
            return numbers, z, R
        exists = with_image(self._expected(numbers), self._k)
        self._dropped += exists.size - int(exists.sum())
        return numbers[exists], z[exists], R[exists]

    def _expected(self, numbers: IntArray) -> FloatArray:
        return self._sensor.predict(self._T, self._landmarks[numbers])

    def _augment(self, entries: Entries) -> FloatArray:
        """New landmarks at their inverse observation, correlated with everything known; returns G (a, p)."""
        ids, R = entries.ids, entries.R
        positions = placed(self._entry_sensor, self._T, entries, self._k)
        T_at, landmarks_at = self._policy.new(self._T, ids, positions)
        # 0 = H_pose e + H_land r - v, solved for r: no sensor needs a Jacobian of its inverse.
        H_pose, H_land = self._jacobians(self._entry_sensor, T_at, landmarks_at)
        H_inv = np.linalg.inv(H_land)
        G = -(H_inv @ H_pose).reshape(-1, self._chart.p)
        self._grow(ids, positions, G, block_diagonal(H_inv @ R @ np.swapaxes(H_inv, 1, 2)))
        return G

    def _grow(self, ids: IntArray, positions: FloatArray, G: FloatArray, N: FloatArray) -> None:
        self._P.augment(G, N)
        if self.history is not None:
            self.history.events.append(Growth(G))
        if self._unanchored is not None:
            self._unanchored.grow(G, N)
        count = len(self._number)
        self._landmarks = np.concatenate([self._landmarks, positions])
        for offset, landmark in enumerate(ids.tolist()):
            self._number[landmark] = count + offset

    def _correct(self, numbers: IntArray, z: FloatArray, R: FloatArray) -> None:
        """One Gauss–Newton step on prior and observations, in covariance form."""
        seen = self._landmarks[numbers]
        y = self._sensor.residual(z, self._sensor.predict(self._T, seen)).ravel()
        T_at, landmarks_at = self._policy.known(self._T, numbers, seen)
        self._points = T_at, landmarks_at, numbers
        H_pose, H_land = self._jacobians(self._sensor, T_at, landmarks_at)
        dx = self._condition(self._touched(numbers), y, stacked(H_pose, H_land), block_diagonal(R))
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

    def _touched(self, numbers: IntArray) -> IntArray:
        """The states (c,) of the pose and of the landmarks with these numbers."""
        return np.concatenate([self._pose_states, (numbers[:, None] * self._chart.n + self._axes).ravel()])

    def _condition(self, touched: IntArray, y: FloatArray, H: FloatArray, R: FloatArray) -> FloatArray:
        """Take the linear observation ``y = H error``, H (k, c), into P; the mean error given it, (states,).

        Raises:
            DivergedError: S is not positive definite, or y not finite.
        """
        PHt = self._P.columns(touched, self._chart.n) @ H.T
        S = H @ PHt[touched] + R
        L, failed = dpotrf(S, lower=1)
        W_t, _ = dtrtrs(L, PHt.T, lower=1, overwrite_b=1)
        e, _ = dtrtrs(L, y, lower=1)
        nis = float(e @ e)
        # dpotrf lets NaN through; it always reaches the NIS.
        if failed or not math.isfinite(nis):
            raise DivergedError(
                f"frame {self._k}: the innovation covariance is not positive definite, or the innovation "
                "not finite; the filter has lost its covariance, or a measurement is spoilt"
            )
        self._P.downdate(W_t)
        self._nis, self._nis_dof = nis, y.size
        if self.history is not None:
            whitened, _ = dtrtrs(L, H, lower=1)
            self.history.events.append(Correction(touched, whitened, W_t, e))
        if self._unanchored is not None:
            self._note_observation(touched, H, R)
        dx: FloatArray = e @ W_t
        return dx

    def _note_observation(self, touched: IntArray, H: FloatArray, R: FloatArray) -> None:
        assert self._unanchored is not None
        self._unanchored.observe(touched, H, R)

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

    @property
    def _identity(self) -> FloatArray:
        return np.eye(self._chart.p)


def stacked(H_pose: FloatArray, H_land: FloatArray) -> FloatArray:
    """H without its zero columns, (m d, p + m n): pose first, then the landmarks seen, block by block."""
    return np.concatenate([H_pose.reshape(-1, H_pose.shape[2]), block_diagonal(H_land)], axis=1)


def sandwich(A: FloatArray | None, P: FloatArray) -> FloatArray:
    """A P A^T, exactly symmetric; None is the identity."""
    if A is None:
        return P
    product = A @ P @ A.T
    return 0.5 * (product + np.swapaxes(product, -1, -2))
