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
from scipy.linalg.lapack import dpotrf, dtrtrs

from slamcmp.errors import DivergedError
from slamcmp.geometry import change_of_axes, rotation, so3_left_jacobian, so3_log, translation
from slamcmp.types import FloatArray, IntArray


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

    The pose's difference to the centre is (p - p_c, log(R_c^T R)) in the centre's axes. With first estimates
    its Jacobian is the one at the centre, so that the information on world components stays what it was.
    """

    quadratic: Quadratic
    T: FloatArray
    landmarks: FloatArray
    first_estimates: bool = False

    def linearised(self, T: FloatArray, landmarks: FloatArray) -> Quadratic:
        """The cost as a function of the body-tangent and landmark errors at another point."""
        difference, J = self._difference(T)
        offset = np.concatenate([difference, (landmarks - self.landmarks).ravel()])
        return self.quadratic.recentred(offset).with_pose_error(J)

    def jacobian(self, T: FloatArray) -> FloatArray:
        """Of the pose's difference by its body-tangent error at T, (p, p)."""
        return self._difference(T)[1]

    def _difference(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        shift = rotation(self.T).T @ (translation(T) - translation(self.T))
        turn = rotation(self.T).T @ rotation(T)
        J = change_of_axes(T, self.T)
        if shift.size == 2:
            return np.array([*shift, np.arctan2(turn[1, 0], turn[0, 0])]), J
        omega = so3_log(turn)
        if not self.first_estimates:
            # Of log(R_c^T R exp(omega)): the right Jacobian's inverse, the left one being that of -omega.
            J[:3, :3] = np.linalg.inv(so3_left_jacobian(-omega))
        return np.concatenate([omega, shift]), J
