"""A Gaussian prior on some variables, in information form, and how variables are eliminated from it.

========  ===================================================================
symbol    meaning
========  ===================================================================
Lam, eta  information matrix (s, s) and vector (s,): the cost is
          delta^T Lam delta - 2 eta^T delta + c
c         what is left of the cost at delta = 0
T, l      centre: the pose (n+1, n+1) and landmarks (L, n) where delta = 0
J         derivative of delta by the body tangent of the current pose
========  ===================================================================

The order of the variables is the pose, then the landmarks. Schur complement: Barfoot 2017, sec. 2.2.3;
Dellaert and Kaess 2017, sec. 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.errors import DivergedError
from slamcmp.geometry import inverse, log, right_jacobian

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass
class Quadratic:
    """``delta^T Lam delta - 2 eta^T delta + c``."""

    Lam: FloatArray
    eta: FloatArray
    c: float = 0.0

    def recentred(self, step: FloatArray) -> Quadratic:
        """The same function of ``delta - step``."""
        slope = self.Lam @ step
        return Quadratic(self.Lam, self.eta - slope, self.c + float(step @ (slope - 2.0 * self.eta)))

    def with_pose_error(self, J: FloatArray) -> Quadratic:
        """The same as a function of another pose error, of which the first p states are J (p, p) times."""
        p = J.shape[0]
        Lam, eta = self.Lam.copy(), self.eta.copy()
        Lam[:p] = J.T @ Lam[:p]
        Lam[:, :p] = Lam[:, :p] @ J
        eta[:p] = J.T @ eta[:p]
        return Quadratic(Lam, eta, self.c)

    def eliminated(self, states: IntArray) -> Quadratic:
        """The minimum over ``states``, as a function of the others in their order.

        Raises:
            DivergedError: the states are not determined.
        """
        keep = np.ones(self.eta.size, dtype=bool)
        keep[states] = False
        L, failed = dpotrf(self.Lam[np.ix_(states, states)], lower=1)
        if failed:
            raise DivergedError("a variable to be marginalised is not determined by its measurements")
        right = np.concatenate([self.Lam[np.ix_(states, keep)], self.eta[states, None]], axis=1)
        solved, _ = dtrtrs(L, right, lower=1)
        W, e = solved[:, :-1], solved[:, -1]
        return Quadratic(
            self.Lam[np.ix_(keep, keep)] - W.T @ W, self.eta[keep] - W.T @ e, self.c - float(e @ e)
        )


@dataclass(frozen=True)
class Prior:
    """A quadratic cost on the oldest pose and the first landmarks, about a centre.

    ``in_world_axes``: the pose's difference to the centre is (p - p_c, log(R R_c^T)), and the information
    is on those world components, so its Jacobian stays what it was; otherwise it is log(T_c^-1 T).
    """

    quadratic: Quadratic
    T: FloatArray
    landmarks: FloatArray
    in_world_axes: bool = False

    def linearised(self, T: FloatArray, landmarks: FloatArray) -> Quadratic:
        """The cost as a function of the body-tangent and landmark errors at another point."""
        difference, J = self._difference(T)
        offset = np.concatenate([difference, (landmarks - self.landmarks).ravel()])
        return self.quadratic.recentred(offset).with_pose_error(J)

    def _difference(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        relative = inverse(self.T) @ T
        xi = log(relative)
        if not self.in_world_axes:
            return xi, np.asarray(np.linalg.inv(right_jacobian(xi)), dtype=np.float64)
        n = T.shape[0] - 1
        to_world = world_axes(self.T)
        turn = xi.copy()
        shift = relative[:n, n]
        if n == 2:
            turn[:2] = shift
        else:
            turn[3:] = shift
        return to_world @ turn, world_axes(T)


def world_axes(T: FloatArray) -> FloatArray:
    """(p, p): the body-tangent error at T in world axes."""
    n = T.shape[0] - 1
    R = T[:n, :n]
    p = 3 if n == 2 else 6
    blocks = np.zeros((p, p))
    blocks[:n, :n] = R
    if n == 2:
        blocks[2, 2] = 1.0
    else:
        blocks[3:, 3:] = R
    return blocks


def in_world_axes(quadratic: Quadratic, T: FloatArray) -> Quadratic:
    """The quadratic of a body-tangent error at T (first p states) on its world components."""
    return quadratic.with_pose_error(world_axes(T).T)
