"""The front end's own map, in the robot's frame: all that association has to expect detections with.

Landmarks are kept where the robot sees them. Odometry moves them all at once, which is what correlates them;
a detection, turned into a point in the body frame, measures one of them directly, so that the correction is
linear however far off the expectation was (Castellanos et al. 2007 map in this frame for that reason). No
pose in the world is needed, and no back end's estimate. Odometry may be too long or too short by a constant
share of what was driven and of what was turned; both are states.

========  =====================================================================
symbol    meaning
========  =====================================================================
a         share by which odometry's translation and rotation are too short, (2,)
q         landmarks in the body frame, (L, n)
P         joint covariance of a and q, (2 + n L, 2 + n L)
x, N      detections as points in the body frame (m, n) and their noise (m, n, n)
w         the increment's tangent, log T
========  =====================================================================
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from slamcmp.association.compatibility import Innovations, uncorrelated
from slamcmp.errors import DivergedError
from slamcmp.geometry import exp, inverse, log, right_jacobian, transform
from slamcmp.models.sensors import body_point_jacobians
from slamcmp.types import FloatArray, IntArray

SCALES = 2


class OwnMap:
    """A Kalman filter of landmarks in the body frame.

    Args:
        n: dimension of space.
        scale_sigma: of each share a.
    """

    def __init__(self, n: int, scale_sigma: float) -> None:
        self.a: FloatArray = np.zeros(SCALES)
        self.q: FloatArray = np.empty((0, n))
        self.P: FloatArray = np.eye(SCALES) * scale_sigma**2
        self._origin = np.eye(n + 1)
        turning = slice(2, 3) if n == 2 else slice(0, 3)
        self._parts = np.zeros((3 if n == 2 else 6, SCALES))
        self._parts[:, 0] = 1.0
        self._parts[turning] = [0.0, 1.0]

    def predict(self, T_prev_body: FloatArray, Q: FloatArray) -> None:
        """Carry the landmarks into the new body frame; the step's noise moves all of them together."""
        count, n = self.q.shape
        if not count:
            return
        w = log(T_prev_body)
        scaled = w * (1.0 + self._parts @ self.a)
        T_body_prev = inverse(exp(scaled))
        self.q = transform(T_body_prev, self.q)
        H = body_point_jacobians(self._origin, self.q)[0].reshape(count * n, -1)
        R = T_body_prev[:-1, :-1]
        P = self.P.copy()
        H_a = H @ (right_jacobian(scaled) @ (w[:, None] * self._parts))
        cross = self._turned(R, P[SCALES:, :SCALES])
        own = self._turned(R, self._turned(R, P[SCALES:, SCALES:]).T)
        moved = cross @ H_a.T
        P[SCALES:, SCALES:] = own + moved + moved.T + H_a @ P[:SCALES, :SCALES] @ H_a.T + H @ Q @ H.T
        P[SCALES:, :SCALES] = cross + H_a @ P[:SCALES, :SCALES]
        P[:SCALES, SCALES:] = P[SCALES:, :SCALES].T
        self.P = 0.5 * (P + P.T)

    def innovations(self, x: FloatArray, N: FloatArray, rows: IntArray) -> Innovations:
        """Of every detection with the landmarks ``rows`` (L,)."""
        blocks = self._blocks(rows, rows)
        return Innovations(self._deviations(self.q[rows][None], x[:, None]), blocks, uncorrelated(N))

    def correct(self, rows: IntArray, x: FloatArray, N: FloatArray) -> None:
        """Take in detections (m, n) of the landmarks ``rows`` (m,).

        Raises:
            DivergedError: the innovations' covariance is not positive definite.
        """
        if rows.size:
            m, n = x.shape
            H = np.zeros((m * n, len(self.P)))
            H[np.arange(m * n), self._states(rows)] = 1.0
            noise = uncorrelated(N).transpose(0, 2, 1, 3).reshape(m * n, m * n)
            self._update(H, self._deviations(self.q[rows], x).ravel(), noise)

    def add(self, x: FloatArray, N: FloatArray) -> int:
        """One landmark (n,) with covariance (n, n), which knows nothing of the others yet; its row."""
        size, n = len(self.P), self.q.shape[1]
        P = np.zeros((size + n, size + n))
        P[:size, :size], P[size:, size:] = self.P, N
        self.q, self.P = np.concatenate([self.q, x[None]]), P
        return len(self.q) - 1

    def drop(self, row: int) -> None:
        """Forget a landmark; those after it move up by one row."""
        states = self._states(np.array([row]))
        self.P = np.delete(np.delete(self.P, states, 0), states, 1)
        self.q = np.delete(self.q, row, 0)

    def _update(self, H: FloatArray, y: FloatArray, noise: FloatArray) -> None:
        PH = self.P @ H.T
        try:
            L = np.linalg.cholesky(H @ PH + noise)
        except np.linalg.LinAlgError as error:
            raise DivergedError("the front end's own map has lost its covariance") from error
        W = solve_triangular(L, PH.T, lower=True).T
        dx = W @ solve_triangular(L, y, lower=True)
        self.a = self.a + dx[:SCALES]
        # W W^T is symmetric to the bit, so P stays so.
        self.P = self.P - W @ W.T
        self._move(dx[SCALES:].reshape(self.q.shape))

    def _deviations(self, q: FloatArray, x: FloatArray) -> FloatArray:
        """Of points x (…, n) from landmarks q (…, n), in the tangent at q that P is of."""
        return x - q

    def _move(self, d: FloatArray) -> None:
        """Move the landmarks along d (L, n) in their tangents."""
        self.q = self.q + d

    def _states(self, rows: IntArray) -> IntArray:
        n = self.q.shape[1]
        return np.asarray((SCALES + rows[:, None] * n + np.arange(n)).ravel())

    def _blocks(self, rows: IntArray, columns: IntArray) -> FloatArray:
        n = self.q.shape[1]
        part = self.P[np.ix_(self._states(rows), self._states(columns))]
        return part.reshape(rows.size, n, columns.size, n).transpose(0, 2, 1, 3)

    @staticmethod
    def _turned(R: FloatArray, columns: FloatArray) -> FloatArray:
        """R on the landmarks' rows of a matrix (n L, c)."""
        turned = R @ columns.reshape(-1, len(R), columns.shape[1])
        return turned.reshape(columns.shape)
