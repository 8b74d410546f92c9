"""Odometry increments with covariance, from a unicycle, the course's bicycle car, or wheel encoders.

Each model turns one control u and a time step dt into the pose increment ``T_prev_body`` and maps the
control noise M into the increment's body tangent, Q = G M G^T. G is the derivative of the *right*
perturbation: ``increment(u + du) ≈ increment(u) exp(G du)``.

========  =====================================================================
symbol    meaning
========  =====================================================================
u         control, (..., c)
M         covariance of the control noise, (..., c, c)
G         (..., 3, c), control to body tangent
Q         (..., 3, 3), covariance of the increment in the body tangent
========  =====================================================================
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from slamcmp.errors import DataError
from slamcmp.geometry import adjoint, exp, inverse, right_jacobian, se2
from slamcmp.types import FloatArray


class MotionModel(Protocol):
    """Planar motion from controls; batch axes allowed in front of ``u``."""

    control_names: tuple[str, ...]

    def increment(self, u: FloatArray, dt: float) -> FloatArray:
        """``T_prev_body``, (..., 3, 3)."""

    def jacobian(self, u: FloatArray, dt: float) -> FloatArray:
        """G, (..., 3, c)."""


class Unicycle:
    """Speed [m/s] and turn rate [rad/s], held over the step: the exact arc ``exp((v, 0, w) dt)``."""

    control_names: tuple[str, ...] = ("speed_m_s", "turn_rate_rad_s")

    def increment(self, u: FloatArray, dt: float) -> FloatArray:
        return exp(self._twist(u, dt))

    def jacobian(self, u: FloatArray, dt: float) -> FloatArray:
        J = right_jacobian(self._twist(u, dt))
        return J[..., :, [0, 2]] * dt

    @staticmethod
    def _twist(u: FloatArray, dt: float) -> FloatArray:
        u = np.asarray(u, dtype=np.float64)
        return np.stack([u[..., 0] * dt, np.zeros_like(u[..., 0]), u[..., 1] * dt], axis=-1)


class StraightThenTurn:
    """Drive v dt along the old heading, then turn by w dt (the discrete model of most EKF-SLAM papers)."""

    control_names: tuple[str, ...] = ("speed_m_s", "turn_rate_rad_s")

    def increment(self, u: FloatArray, dt: float) -> FloatArray:
        u = np.asarray(u, dtype=np.float64)
        return se2(u[..., 0] * dt, 0.0, u[..., 1] * dt)

    def jacobian(self, u: FloatArray, dt: float) -> FloatArray:
        u = np.asarray(u, dtype=np.float64)
        angle = u[..., 1] * dt
        G = np.zeros((*u.shape[:-1], 3, 2))
        # The translation noise acts before the turn, so the new body frame sees it turned back.
        G[..., 0, 0], G[..., 1, 0] = np.cos(angle) * dt, -np.sin(angle) * dt
        G[..., 2, 1] = dt
        return G


class Bicycle:
    """The course's car: speed of the rear axle [m/s] and steering angle [rad], wheelbase [m].

    The body frame sits on the rear axle; turn rate = v tan(steer) / wheelbase, held over the step.

    Raises:
        DataError: the wheelbase is not positive.
    """

    control_names: tuple[str, ...] = ("speed_m_s", "steering_rad")

    def __init__(self, *, wheelbase_m: float) -> None:
        if not wheelbase_m > 0:
            raise DataError(f"bicycle: wheelbase_m is {wheelbase_m}; a positive length is needed")
        self.wheelbase_m = wheelbase_m

    def increment(self, u: FloatArray, dt: float) -> FloatArray:
        return exp(self._twist(u, dt))

    def jacobian(self, u: FloatArray, dt: float) -> FloatArray:
        u = np.asarray(u, dtype=np.float64)
        v, steer = u[..., 0], u[..., 1]
        d_twist = np.zeros((*u.shape[:-1], 3, 2))
        d_twist[..., 0, 0] = dt
        d_twist[..., 2, 0] = dt * np.tan(steer) / self.wheelbase_m
        d_twist[..., 2, 1] = dt * v / (self.wheelbase_m * np.cos(steer) ** 2)
        return right_jacobian(self._twist(u, dt)) @ d_twist

    def _twist(self, u: FloatArray, dt: float) -> FloatArray:
        u = np.asarray(u, dtype=np.float64)
        v, steer = u[..., 0], u[..., 1]
        turn = v * np.tan(steer) / self.wheelbase_m
        return np.stack([v * dt, np.zeros_like(v), turn * dt], axis=-1)


class WheelEncoders:
    """Distances rolled by the left and right wheel in the step [m] (``dt`` is not used); track width [m].

    Raises:
        DataError: the track width is not positive.
    """

    control_names: tuple[str, ...] = ("left_m", "right_m")

    def __init__(self, *, track_width_m: float) -> None:
        if not track_width_m > 0:
            raise DataError(f"encoders: track_width_m is {track_width_m}; a positive length is needed")
        self._d_twist = np.array([[0.5, 0.5], [0.0, 0.0], [-1.0 / track_width_m, 1.0 / track_width_m]])

    def increment(self, u: FloatArray, dt: float = 1.0) -> FloatArray:  # noqa: ARG002
        return exp(np.asarray(u, dtype=np.float64) @ self._d_twist.T)

    def jacobian(self, u: FloatArray, dt: float = 1.0) -> FloatArray:  # noqa: ARG002
        G: FloatArray = right_jacobian(np.asarray(u, dtype=np.float64) @ self._d_twist.T) @ self._d_twist
        return G


def compose_increments(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Two successive increments (T, Q) as one; Q to first order, Ad(T2^-1) Q1 Ad(T2^-1)^T + Q2.

    Summing the noise of several sub-steps gives the full rank that a single control step lacks.
    """
    (T1, Q1), (T2, Q2) = first, second
    A = adjoint(inverse(T2))
    return T1 @ T2, A @ Q1 @ np.swapaxes(A, -1, -2) + Q2
