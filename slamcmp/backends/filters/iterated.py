"""Iterated EKF-SLAM: the frame's cost minimised by Gauss–Newton instead of one step of it.

The cost of a frame is |s|² in the prior's covariance plus the whitened residuals of its observations (Bell
and Cathey 1993), where s is the offset from the predicted mean in the world chart, additive in position and
landmarks. There the prior is quadratic, so Gauss–Newton from iterate s_i is the Kalman update with y + H s_i
in place of y; H is taken at the iterate and carried to s by the left Jacobian of the rotation. New landmarks
fit exactly, so they only follow the pose's last linearisation. One iteration is ``ekf_slam``.

========  =================================================================
symbol    meaning
========  =================================================================
s         offset from the predicted mean, pose (p,) and landmarks
J         at the pose's part of s: d(error of the pose there) = J ds
y, H, R   stacked innovation, Jacobian and noise of the known landmarks
========  =================================================================
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.filters.covariances.covariance import block_diagonal, stacked
from slamcmp.backends.filters.error_state.charts import WorldChart
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf
from slamcmp.backends.filters.loops import Loops, Recipe
from slamcmp.backends.filters.map_filter import Observed
from slamcmp.backends.relaxation import relaxed_share
from slamcmp.backends.robust import RobustKernel, robust_kernel
from slamcmp.geometry import so3_left_jacobian
from slamcmp.registry import back_ends
from slamcmp.types import FloatArray, IntArray, Problem


@back_ends.register("iterated_ekf")
class IteratedEkf(ErrorStateEkf):
    """EKF-SLAM that relinearises every frame's observations until the estimate rests.

    Args:
        problem: prior and sensor.
        iterations: most Gauss–Newton steps a frame; 1 is the plain EKF. A step after one that jumped over
            the minimum is shortened, but for the last.
        tolerance: a step whose largest entry [m or rad] is below it is the last.
        smooth: keep the history and offer ``trajectory()`` (RTS).
        robust, robust_width: see ../robust.py; the weights are those of each linearisation.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        iterations: Annotated[int, Ge(1)] = 10,
        tolerance: Annotated[float, Gt(0)] = 1e-12,
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = WorldChart(problem.sensor.space_dim)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(
            problem, chart, LatestEstimate(), new_landmarks="update_first", smooth=smooth, kernel=kernel
        )
        self._iterations, self._tolerance = iterations, tolerance
        self._loops = Loops(self, Recipe("WORLD", False, iterations=iterations, tolerance=tolerance))

    def solve(self, seen: Observed) -> None:
        """Gauss–Newton on the frame's cost until it rests."""
        p = self._chart.p
        T_prior, landmarks_prior = self._T, self._landmarks
        T_linear, since = T_prior, np.zeros(p)
        s = np.zeros(p + landmarks_prior.size)
        if seen.numbers.size:
            s_linear, touched, y, H, R = self._last_linearisation(self._visible(seen))
            s = self._P.observe(touched, H, R, y)
            J = self._carried(s_linear)
            # The covariance belongs to the errors at the point of linearisation, as the plain EKF's does.
            self._P.move(J)
            T_linear = self._chart.retract(T_prior, landmarks_prior[:0], s_linear[:p])[0]
            since = J @ (s[:p] - s_linear[:p])
        if seen.entries is not None:
            self._T = T_linear
            G = self._augment(seen.entries)
            s = np.concatenate([s, G @ since])
            landmarks_prior = self._landmarks
        self._T, self._landmarks = self._chart.retract(T_prior, landmarks_prior, s)

    def _last_linearisation(
        self, seen: Observed
    ) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """Iterate on the touched states only; s (c,) where it ended, and the linear observation there."""
        touched, R = self._P.touch(seen.numbers, self._landmarks), block_diagonal(seen.R)
        P = self._P.block(touched)
        landmarks_prior = self._landmarks[seen.numbers]
        s = np.zeros(touched.size)
        last_step: FloatArray | None = None
        share = 1.0
        for remaining in reversed(range(self._iterations)):
            T, landmarks = self._chart.retract(self._T, landmarks_prior, s)
            self._points = T, landmarks, seen.numbers
            H_pose, H_land = self._jacobians(self._sensor, T, landmarks)
            H = stacked(H_pose @ self._carried(s), H_land)
            y = self._sensor.residual(seen.z, self._sensor.predict(T, landmarks)).ravel() + H @ s
            if remaining:
                S_known = H @ P @ H.T
                step = P @ H.T @ np.linalg.solve(S_known + self._P.noise_of(S_known, R, y), y) - s
                if np.abs(step).max() < self._tolerance:
                    break
                share, last_step = relaxed_share(step, last_step, share), step
                s = s + share * step
        return s, touched, y, H, R

    def _carried(self, s: FloatArray) -> FloatArray:
        """J (p, p): all is additive but the rotation in space."""
        J = np.eye(self._chart.p)
        if self._chart.n == 3:
            J[:3, :3] = so3_left_jacobian(s[:3])
        return J
