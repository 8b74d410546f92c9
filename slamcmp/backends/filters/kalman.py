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
from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from slamcmp.backends.filters.covariance import block_diagonal
from slamcmp.backends.filters.rts_smoother import Correction, FrameEnd, Growth, History, Step
from slamcmp.errors import DivergedError, UsageError
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, FloatArray, Frame, Landmarks, Problem, Trajectory


class KalmanFilter:
    """Mean and covariance of a linear system with Gaussian noise (Kalman 1960).

    Args:
        x: prior mean, (s,).
        P: prior covariance, (s, s).
        smooth: keep what :meth:`smoothed` needs; augmented states must then be constant ones.
    """

    def __init__(self, x: FloatArray, P: FloatArray, *, smooth: bool = False) -> None:
        self.x = np.array(x, dtype=np.float64)
        self.P = np.array(P, dtype=np.float64)
        self._s = self.x.size
        self.history = History(self._s, self._s) if smooth else None

    def predict(self, A: FloatArray, Q: FloatArray, b: FloatArray | float = 0.0) -> None:
        """Propagate: x = A x + b, P = A P A^T + Q (Problem 3)."""
        self.x = A @ self.x + b
        P = A @ self.P @ A.T + Q
        self.P = 0.5 * (P + P.T)
        if self.history is not None:
            self.history.events.append(Step(A[: self._s, : self._s]))

    def correct(self, measurement: FloatArray, C: FloatArray, R: FloatArray) -> float:
        """Condition on ``measurement = C x + v`` (Problem 4); returns the squared innovation y^T S^-1 y.

        Raises:
            DivergedError: the innovation covariance is not positive definite.
        """
        PCt = self.P @ C.T
        y = measurement - C @ self.x
        try:
            S = cho_factor(C @ PCt + R, lower=True)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise DivergedError(f"the innovation covariance is not positive definite: {error}") from error
        K = cho_solve(S, PCt.T).T
        self.x = self.x + K @ y
        # Joseph's form: stays positive semi-definite whatever the rounding in K.
        keep = np.eye(self.x.size) - K @ C
        P = keep @ self.P @ keep.T + K @ R @ K.T
        self.P = 0.5 * (P + P.T)
        if self.history is not None:
            H, W_t, e = (solve_triangular(S[0], right, lower=True) for right in (C, PCt.T, y))
            self.history.events.append(Correction(np.arange(self.x.size), H, W_t, e))
        return float(y @ cho_solve(S, y))

    def augment(self, G: FloatArray, N: FloatArray, x_new: FloatArray) -> None:
        """Append states ``x_new`` whose error is G (error of x) + noise of covariance N."""
        cross = G @ self.P
        corner = cross @ G.T + N
        self.x = np.concatenate([self.x, x_new])
        self.P = np.block([[self.P, cross.T], [cross, 0.5 * (corner + corner.T)]])
        if self.history is not None:
            self.history.events.append(Growth(G[:, : self._s]))

    def mark(self, t: float = 0.0) -> None:
        """Have :meth:`smoothed` answer for this moment too."""
        if self.history is not None:
            self.history.events.append(FrameEnd(t, self.x[: self._s], self.P[: self._s]))

    def smoothed(self) -> tuple[FloatArray, FloatArray]:
        """Mean (K, s) and covariance (K, s, s) of the first s states at each marked moment, given all data.

        Rauch, Tung, Striebel 1965, in the form of filter_history.py. Needs ``smooth``.
        """
        if self.history is None:
            raise UsageError("this Kalman filter kept no history; construct it with smooth=True")
        frames, errors, P = self.history.smoothed_errors()
        return np.array([frame.mean for frame in frames]).reshape(-1, self._s) + errors, P


@back_ends.register("kalman_filter")
class KnownHeadingKalmanFilter:
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
        self._filter = KalmanFilter(problem.T_world_body[:2, 2], R @ problem.P[:2, :2] @ R.T, smooth=smooth)
        self._past: list[tuple[float, FloatArray, float]] = []
        if smooth:
            self.trajectory = self._smoothed
        self._number: dict[int, int] = {}
        self._nis, self._nis_dof = 0.0, 0

    def update(self, frame: Frame) -> None:
        """Predict the position with the known heading, add new landmarks, correct with the others."""
        if frame.k > 0:
            self._predict(frame)
        self._nis, self._nis_dof = 0.0, 0
        known = np.array([landmark in self._number for landmark in frame.ids.tolist()], dtype=bool)
        new = ~known
        if new.any():
            self._augment(frame, np.flatnonzero(new))
        if known.any():
            self._correct(frame, np.flatnonzero(known))
        if self._filter.history is not None:
            self._filter.mark()
            self._past.append((frame.t, self._R_world_body, self._heading_variance))

    def estimate(self) -> Estimate:
        """The pose with its position covariance turned into the body tangent."""
        T, P = _pose(self._R_world_body, self._filter.x[:2], self._filter.P[:2, :2], self._heading_variance)
        return Estimate(T, P)

    def landmarks(self) -> Landmarks:
        """Every landmark ever seen, in the order of first sight."""
        count = len(self._number)
        ids = np.fromiter(self._number, dtype=np.int64, count=count)
        blocks = self._filter.P[2:, 2:].reshape(count, 2, count, 2)
        index = np.arange(count)
        return Landmarks(ids, self._filter.x[2:].reshape(count, 2), blocks[index, :, index, :])

    def joint_covariance(self) -> FloatArray:
        """(3 + 2 L, 3 + 2 L): the heading is uncorrelated with the rest."""
        states = self._filter.x.size
        to_tangent = np.zeros((states + 1, states))
        to_tangent[:2, :2] = self._R_world_body.T
        to_tangent[3:, 2:] = np.eye(states - 2)
        joint: FloatArray = to_tangent @ self._filter.P @ to_tangent.T
        joint[2, 2] = self._heading_variance
        return joint

    def diagnostics(self) -> Mapping[str, float]:
        """NIS of the last frame with its degrees of freedom, and the number of landmarks."""
        return {
            "nis": self._nis if self._nis_dof else float("nan"),
            "nis_dof": self._nis_dof,
            "landmarks": len(self._number),
        }

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
        b = np.zeros(self._filter.x.size)
        b[:2] = self._R_world_body @ frame.T_prev_body[:2, 2]
        self._R_world_body = R = self._R_world_body @ frame.T_prev_body[:2, :2]
        self._heading_variance += float(frame.Q[2, 2])
        Q = np.zeros_like(self._filter.P)
        Q[:2, :2] = R @ frame.Q[:2, :2] @ R.T
        self._filter.predict(np.eye(b.size), Q, b)

    def _augment(self, frame: Frame, rows: NDArray[np.int64]) -> None:
        R = self._R_world_body
        count, m = len(self._number), rows.size
        # l = p + R z: every new landmark moves with the position.
        G = np.zeros((2 * m, self._filter.x.size))
        G[:, :2] = np.tile(np.eye(2), (m, 1))
        position = self._filter.x[:2]
        self._filter.augment(
            G, block_diagonal(R @ frame.R[rows] @ R.T), (position + frame.z[rows] @ R.T).ravel()
        )
        for offset, landmark in enumerate(frame.ids[rows].tolist()):
            self._number[landmark] = count + offset

    def _correct(self, frame: Frame, rows: NDArray[np.int64]) -> None:
        R_t = self._R_world_body.T
        C = np.zeros((2 * rows.size, self._filter.x.size))
        for i, landmark in enumerate(frame.ids[rows].tolist()):
            start = 2 + 2 * self._number[landmark]
            C[2 * i : 2 * i + 2, :2] = -R_t
            C[2 * i : 2 * i + 2, start : start + 2] = R_t
        self._nis = self._filter.correct(frame.z[rows].ravel(), C, block_diagonal(frame.R[rows]))
        self._nis_dof = 2 * rows.size


def _pose(
    R: FloatArray, position: FloatArray, P: FloatArray, heading_variance: float
) -> tuple[FloatArray, FloatArray]:
    """Pose (3, 3) and its body-tangent covariance (3, 3) from P (2, 2) of the position in world axes."""
    T, block = np.eye(3), np.zeros((3, 3))
    T[:2, :2], T[:2, 2] = R, position
    block[:2, :2] = R.T @ P @ R
    block[2, 2] = heading_variance
    return T, block
