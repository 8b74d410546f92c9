"""The linear Kalman filter (the course's Problems 2 to 4), and SLAM where it is exact.

Problem 2's system is ``x' = A x + b + w``, ``w ~ N(0, Q)``; ``y = C x + v``, ``v ~ N(0, R)``. Problem 3 is
:meth:`KalmanFilter.predict`; what Problem 4 asks for, the state given observations up to and including the
new one, is what :meth:`KalmanFilter.correct` computes.

========  ==============================================================
symbol    meaning (the lecture's letters where they differ)
========  ==============================================================
x, P      mean mu (s,) and covariance Sigma (s, s)
A, b, Q   dynamics A_t, known input, Sigma_w
C, R      observation C_t and Sigma_v
y, S, K   innovation, its covariance, Kalman gain
========  ==============================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

import numpy as np
from annotated_types import Ge

from slamcmp.backends.entries import Entries
from slamcmp.backends.filters.covariances.covariance import JointCovariance, block_diagonal
from slamcmp.backends.filters.covariances.error_covariance import ErrorCovariance
from slamcmp.backends.filters.error_state.charts import Chart
from slamcmp.backends.filters.map_filter import MapFilter, Observed
from slamcmp.backends.filters.rts_smoother import History
from slamcmp.errors import UsageError
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, IntArray, Problem, Trajectory


class KalmanFilter:
    """Mean and covariance of a linear system with Gaussian noise (Kalman 1960).

    Args:
        x: prior mean, (s,).
        P: prior covariance, (s, s).
        n: augmented states come in groups of so many.
        smooth: keep what :meth:`smoothed` needs.
    """

    def __init__(self, x: FloatArray, P: FloatArray, *, n: int = 1, smooth: bool = False) -> None:
        self.x: FloatArray = np.array(x, dtype=np.float64)
        self.covariance = ErrorCovariance(JointCovariance(P), n)
        self._s = self.x.size
        self.history: History | None = None
        if smooth:
            self.history = self.covariance.add_listener(History(self._s, n))

    @property
    def P(self) -> FloatArray:
        """Covariance of all states, a copy."""
        return self.covariance.dense()

    def predict(self, A: FloatArray, Q: FloatArray, b: FloatArray | float = 0.0) -> None:
        """Propagate: x = A x + b, P = A P A^T + Q (Problem 3); augmented states are constant.

        Args:
            A, Q: (s, s).
            b: (s,).
        """
        s = self._s
        self.x = np.concatenate([A @ self.x[:s] + b, self.x[s:]])
        self.covariance.move(A, Q=Q)

    def correct(
        self, measurement: FloatArray, C: FloatArray, R: FloatArray, states: IntArray | None = None
    ) -> float:
        """Condition on ``measurement = C x + v`` (Problem 4); returns the squared innovation y^T S^-1 y.

        Args:
            measurement: (k,).
            C: (k, c).
            R: (k, k).
            states: which C involves, (c,), the first s among them; None: all.

        Raises:
            DivergedError: the innovation covariance is not positive definite.
        """
        if states is None:
            states = np.arange(self.x.size)
        before = self.covariance.nis
        self.x = self.x + self.covariance.observe(states, C, R, measurement - C @ self.x[states])
        return self.covariance.nis - before

    def augment(self, G: FloatArray, N: FloatArray, x_new: FloatArray) -> None:
        """Append states ``x_new`` (a,) with error G (a, s) times that of x plus noise of covariance N."""
        self.x = np.concatenate([self.x, x_new])
        self.covariance.grow(G, N)

    def mark(self, t: float = 0.0) -> None:
        """Have :meth:`smoothed` answer for this moment too."""
        self.covariance.end_frame(t, self.x[: self._s])

    def smoothed(self) -> tuple[FloatArray, FloatArray]:
        """Mean (K, s) and covariance (K, s, s) of the first s states at each marked moment, given all data.

        Rauch, Tung, Striebel 1965, in the form of rts_smoother.py. Needs ``smooth``.
        """
        if self.history is None:
            raise UsageError("this Kalman filter kept no history; construct it with smooth=True")
        frames, errors, P = self.history.smoothed_errors()
        return np.array([frame.mean for frame in frames]).reshape(-1, self._s) + errors, P


@back_ends.register("kalman_filter")
class KnownHeadingKalmanFilter(MapFilter):
    """Linear Kalman-filter SLAM for a robot whose heading is known (a compass): the case without a gap.

    With the heading given, odometry and relative positions are linear in (position, landmarks), so this
    filter and every smoother must agree to rounding: the control experiment of filter against smoother.
    The reported heading variance is the prior's plus what the increments add; it is not estimated.

    Args:
        problem: planar, with the ``relative_position`` sensor.
        heading_sigma_max_deg: most heading noise a prior or an increment may carry and still be called
            known [deg].
        smooth: keep the history and offer ``trajectory()`` (Rauch, Tung, Striebel).

    Raises:
        UsageError: another sensor, or a heading that is not known.
        DivergedError: the innovation covariance is not positive definite.
    """

    trajectory: Callable[[], Trajectory]
    """Every pose with hindsight; exists only with ``smooth``, so that a plain filter is no smoother."""

    def __init__(
        self,
        problem: Problem,
        *,
        heading_sigma_max_deg: Annotated[float, Ge(0)] = 0.01,
        smooth: bool = False,
    ) -> None:
        if problem.sensor.name != "relative_position" or problem.sensor.space_dim != 2:
            raise UsageError(
                f"kalman_filter: sensor {problem.sensor.name!r} is not linear; use the planar "
                "'relative_position' sensor, or the back end 'ekf_slam'"
            )
        self._heading_variance_max = math.radians(heading_sigma_max_deg) ** 2
        self._check_heading(problem.P, "the prior")
        self._R_world_body = problem.T_world_body[:2, :2]
        self._heading_variance = float(problem.P[2, 2])
        R = self._R_world_body
        x, P = problem.T_world_body[:2, 2], R @ problem.P[:2, :2] @ R.T
        self._filter = KalmanFilter(x, P, n=2, smooth=smooth)
        super().__init__(problem, Chart(2), self._filter.covariance)
        self._past: list[tuple[float, FloatArray, float]] = []
        if smooth:
            self.trajectory = self._smoothed

    def update(self, frame: Frame) -> None:
        """Predict the position with the known heading, add new landmarks, correct with the others."""
        seen = self.construct(frame)
        self.solve(seen)
        self.marginalise(frame)

    def construct(self, frame: Frame) -> Observed:
        """The frame's cost: the prior carried over the odometry, and what was observed."""
        self._begin(frame)
        if frame.k > 0:
            self._predict(frame)
        seen = self._sorted(frame)
        if seen.entries is not None:
            self._augment(seen.entries)
        return seen

    def solve(self, seen: Observed) -> None:
        """The minimum of that cost, which is quadratic."""
        if not seen.numbers.size:
            return
        R_t = self._R_world_body.T
        C = np.zeros((2 * seen.numbers.size, 2 + 2 * seen.numbers.size))
        C[:, :2] = np.tile(-R_t, (seen.numbers.size, 1))
        C[:, 2:] = block_diagonal(np.broadcast_to(R_t, (seen.numbers.size, 2, 2)))
        touched = self._P.touch(seen.numbers, self._landmarks)
        self._filter.correct(seen.z.ravel(), C, block_diagonal(seen.R), touched)
        self._landmarks = self._filter.x[2:].reshape(-1, 2)

    def marginalise(self, frame: Frame) -> None:
        """The posterior of position and map is the next frame's prior."""
        self._filter.mark(frame.t)
        self._past.append((frame.t, self._R_world_body, self._heading_variance))

    def estimate(self) -> Estimate:
        """The pose with its position covariance turned into the body tangent."""
        T, P = _pose(self._R_world_body, self._filter.x[:2], self._P.pose_block(), self._heading_variance)
        return Estimate(T, P)

    def joint_covariance(self) -> FloatArray:
        """(3 + 2 L, 3 + 2 L): the heading is uncorrelated with the rest."""
        states = self._filter.x.size
        to_tangent = np.zeros((states + 1, states))
        to_tangent[:2, :2] = self._R_world_body.T
        to_tangent[3:, 2:] = np.eye(states - 2)
        joint: FloatArray = to_tangent @ self._filter.P @ to_tangent.T
        joint[2, 2] = self._heading_variance
        return joint

    def _smoothed(self) -> Trajectory:
        """Every pose given all observations; the heading is as it was."""
        positions, P = self._filter.smoothed()
        poses = [
            _pose(R, position, block, variance)
            for (_, R, variance), position, block in zip(self._past, positions, P, strict=True)
        ]
        return Trajectory(
            np.array([t for t, _, _ in self._past]),
            np.array([T for T, _ in poses]),
            np.array([block for _, block in poses]),
        )

    def _check_heading(self, covariance: FloatArray, what: str) -> None:
        variance = float(covariance[2, 2])
        if variance > self._heading_variance_max:
            raise UsageError(
                f"kalman_filter: {what} has a heading sigma of {math.degrees(math.sqrt(variance)):.3g} deg, "
                "so the heading is not known and the problem not linear; use a source without heading noise, "
                "or the back end 'ekf_slam'"
            )

    def _predict(self, frame: Frame) -> None:
        self._check_heading(frame.Q, f"the odometry of frame {frame.k}")
        step = self._R_world_body @ frame.T_prev_body[:2, 2]
        self._R_world_body = R = self._R_world_body @ frame.T_prev_body[:2, :2]
        self._heading_variance += float(frame.Q[2, 2])
        self._filter.predict(np.eye(2), R @ frame.Q[:2, :2] @ R.T, step)

    def _augment(self, entries: Entries) -> None:
        R = self._R_world_body
        # l = p + R z: every new landmark moves with the position.
        positions = self._filter.x[:2] + entries.z @ R.T
        G = np.tile(np.eye(2), (entries.ids.size, 1))
        self._filter.augment(G, block_diagonal(R @ entries.R @ R.T), positions.ravel())
        self._name(entries, positions)


def _pose(
    R: FloatArray, position: FloatArray, P: FloatArray, heading_variance: float
) -> tuple[FloatArray, FloatArray]:
    """Pose (3, 3) and its body-tangent covariance (3, 3) from P (2, 2) of the position in world axes."""
    T, block = np.eye(3), np.zeros((3, 3))
    T[:2, :2], T[:2, 2] = R, position
    block[:2, :2] = R.T @ P @ R
    block[2, 2] = heading_variance
    return T, block
