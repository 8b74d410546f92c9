"""Odometry alone: where a robot without a sensor would believe it is.

========  ============================================================
symbol    meaning
========  ============================================================
P         covariance of the pose in the body tangent, (p, p)
Q         covariance of the increment, in the tangent at its end
A         adjoint of the increment's inverse: carries an error over it
========  ============================================================
"""

from __future__ import annotations

from typing import Literal

from slamcmp.geometry import adjoint_of_inverse
from slamcmp.registry import back_ends
from slamcmp.types import Estimate, Frame, Problem


@back_ends.register("dead_reckoning")
class DeadReckoning:
    """The prior carried on by the odometry; what every other back end has to beat.

    Args:
        problem: the prior (planar or spatial); the sensor is not used.
    """

    relative_poses: Literal["ignored"] = "ignored"

    def __init__(self, problem: Problem) -> None:
        self._T, self._P = problem.T_world_body, problem.P

    def update(self, frame: Frame) -> None:
        """Compose the frame's increment; its observations and loop closures are ignored."""
        if frame.k > 0:
            A = adjoint_of_inverse(frame.T_prev_body)
            self._T = self._T @ frame.T_prev_body
            self._P = A @ self._P @ A.T + frame.Q

    def estimate(self) -> Estimate:
        """The current pose and its covariance, to first order in the noise."""
        return Estimate(self._T, self._P)
