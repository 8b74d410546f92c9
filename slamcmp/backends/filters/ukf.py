"""UKF-SLAM on a manifold: sigma points in the error chart in place of Jacobians.

Sigma points cover only what a function depends on: the pose for the motion, pose and noise for a new
landmark, pose and observed landmarks for an update (2 c + 1 points for c states, whatever the map's size).
Each function is replaced by its statistical linear regression on those points, y = H e + remainder, whose
remainder's covariance joins the noise; on the states that take part this is the UKF itself, and the others
follow through their covariance with them (Brossard, Barrau, Bonnabel 2020, "A code for unscented Kalman
filtering on manifolds"; scaled points: Julier 2002, Wan and van der Merwe 2000).

========  ====================================================================
symbol    meaning
========  ====================================================================
c, u      dimension of the sampled error, and its points in units of sigma
S, P      P = S S^T, its square root by eigenvectors, so that P may be singular
Y         regression of the values on u, (k, c); H = Y S^-1
Omega     covariance of what the regression leaves, (k, k)
========  ====================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.backends.entries import Entries, placed
from slamcmp.backends.filters.covariances.covariance import block_diagonal
from slamcmp.backends.filters.error_state.charts import (
    Chart,
    LeftInvariantChart,
    RightInvariantChart,
    WorldChart,
)
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf, NewLandmarks
from slamcmp.backends.filters.loops import Loops, Recipe
from slamcmp.backends.filters.map_filter import Observed
from slamcmp.backends.robust import RobustKernel, robust_kernel
from slamcmp.geometry import exp
from slamcmp.registry import back_ends
from slamcmp.types import FloatArray, Frame, IntArray, Problem

CHARTS: dict[str, type[Chart]] = {
    "additive": WorldChart,
    "right_invariant": RightInvariantChart,
    "left_invariant": LeftInvariantChart,
}


@back_ends.register("ukf_slam")
class UkfSlam(ErrorStateEkf):
    """Unscented Kalman filter for SLAM, in one of three error charts.

    The motion is exactly linear in the pose's error of the two invariant charts and is sampled in the
    additive one; how a step carries the landmarks' errors is always the chart's linear map.

    Args:
        problem: prior and sensor.
        retraction: "additive" (SO(n) x R), "right_invariant" or "left_invariant" (SE_{1+L}(n)).
        alpha: spread of the sigma points; 1e-3 samples derivatives, 1 the whole distribution.
        beta: 2 is best for Gaussian errors.
        kappa: second scaling of the spread, sqrt(alpha² (c + kappa)).
        new_landmarks: see error_state_ekf.py.
        smooth: keep the history and offer ``trajectory()`` (unscented RTS, through the regressions).
        robust, robust_width: see ../robust.py; what the regression leaves is not doubted.

    Raises:
        DivergedError: an innovation covariance is not positive definite or not finite.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        retraction: Literal["additive", "right_invariant", "left_invariant"] = "additive",
        alpha: Annotated[float, Gt(0)] = 1e-3,
        beta: Annotated[float, Ge(0)] = 2.0,
        kappa: Annotated[float, Ge(0)] = 0.0,
        new_landmarks: NewLandmarks = "join_first",
        smooth: bool = False,
        robust: RobustKernel = "none",
        robust_width: Annotated[float, Gt(0)] | None = None,
    ) -> None:
        chart = CHARTS[retraction](problem.sensor.space_dim, problem.T_world_body)
        kernel = robust_kernel(robust, robust_width)
        super().__init__(
            problem, chart, LatestEstimate(), new_landmarks=new_landmarks, smooth=smooth, kernel=kernel
        )
        self._alpha, self._beta, self._kappa = alpha, beta, kappa
        self._sampled_motion = retraction == "additive"
        name = {"additive": "WORLD", "right_invariant": "RIGHT", "left_invariant": "LEFT"}[retraction]
        points = (alpha, beta, kappa)
        self._loops = Loops(self, Recipe(name, new_landmarks == "join_first", sigma_points=points))

    def _predict(self, frame: Frame, seen: IntArray) -> None:
        if not self._sampled_motion:
            super()._predict(frame, seen)
            return
        p, none = self._chart.p, self._landmarks[:0]
        T_after = self._T @ frame.T_prev_body

        def moved(errors: FloatArray) -> FloatArray:
            poses = self._chart.retract(self._T, none, errors[:, :p])[0]
            ends = poses @ frame.T_prev_body @ exp(errors[:, p:])
            return self._chart.errors(T_after, none, ends, np.empty((len(ends), 0, self._chart.n)))

        P = np.zeros((2 * p, 2 * p))
        P[:p, :p], P[p:, p:] = self._P.pose_block(), frame.Q
        _, H, Omega = self._regression(moved, P)
        F, G = H[:, :p], H[:, p:]
        noise = G @ frame.Q @ G.T + Omega
        self._P.move(F, Q=noise)
        self._T = T_after

    def _augment(self, entries: Entries) -> FloatArray:
        sensor = self._entry_sensor
        p, d, m = self._chart.p, sensor.dim, entries.ids.size
        positions = placed(sensor, self._T, entries, self._P.frame)

        def entered(errors: FloatArray) -> FloatArray:
            poses = self._chart.retract(self._T, self._landmarks[:0], errors[:, :p])[0]
            noisy = entries.z + errors[:, p:].reshape(-1, m, d)
            landmarks = sensor.invert(poses[:, None], noisy)
            return self._chart.errors(self._T, positions, poses, landmarks)[:, p:]

        P = np.zeros((p + m * d, p + m * d))
        P[:p, :p], P[p:, p:] = self._P.pose_block(), block_diagonal(entries.R)
        _, H, Omega = self._regression(entered, P)
        G, D = H[:, :p], H[:, p:]
        self._enter(entries, positions, G, D @ P[p:, p:] @ D.T + Omega)
        return G

    def _correct(self, seen: Observed) -> None:
        landmarks = self._landmarks[seen.numbers]
        touched = self._P.touch(seen.numbers, self._landmarks)
        z_mean = self._sensor.predict(self._T, landmarks)

        def observed(errors: FloatArray) -> FloatArray:
            poses, moved = self._chart.retract(self._T, landmarks, errors)
            difference = self._sensor.residual(self._sensor.predict(poses[:, None], moved), z_mean)
            return difference.reshape(len(errors), -1)

        mean, H, Omega = self._regression(observed, self._P.block(touched))
        y = self._sensor.residual(seen.z, z_mean).ravel() - mean
        dx = self._P.observe(touched, H, block_diagonal(seen.R), y, Omega)
        self._T, self._landmarks = self._chart.retract(self._T, self._landmarks, dx)

    def _regression(
        self, function: Callable[[FloatArray], FloatArray], P: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean (k,), H (k, c) and Omega (k, k) of ``function`` (points, c) -> (points, k), zero at zero."""
        c = len(P)
        # Metres and radians differ by orders of magnitude: rank is judged on the correlation matrix.
        sigma = np.sqrt(np.maximum(np.diagonal(P), 0.0))
        scale = np.where(sigma > 0, sigma, 1.0)
        variances, directions = np.linalg.eigh(P / np.outer(scale, scale))
        alive = variances > 1e-14 * c
        root = np.sqrt(np.where(alive, variances, 0.0))
        S = scale[:, None] * directions * root
        spread = self._alpha * math.sqrt(c + self._kappa)
        weight = 0.5 / spread**2
        errors = spread * np.concatenate([S.T, -S.T])
        values = function(errors)
        mean = weight * values.sum(axis=0)
        Y = weight * spread * (values[:c] - values[c:]).T
        # sum of w (v - mean)(v - mean)^T with the centre point's v = 0 and its own weight.
        centre = 1.0 - c / spread**2 + 1.0 - self._alpha**2 + self._beta
        moments = weight * (values - mean).T @ (values - mean) + centre * np.outer(mean, mean)
        Omega = moments - Y @ Y.T
        inverse_root = np.divide(1.0, root, out=np.zeros_like(root), where=alive)
        H = (Y * inverse_root) @ directions.T / scale
        return mean, H, 0.5 * (Omega + Omega.T)
