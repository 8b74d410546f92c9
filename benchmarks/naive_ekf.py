"""The yardstick of ``ekf.py``: EKF-SLAM as most teaching code writes it.

One update per observation, each with a dense H over the whole state and the textbook covariance
``(I - K H) P``, multiplied out so that it costs n² and not n³. Planar, range-bearing, known association,
world-additive pose error.
"""

from __future__ import annotations

import numpy as np


class NaiveEkfSlam:
    """Sequential, dense-H EKF-SLAM; state (x, y, theta, l1x, l1y, ...)."""

    def __init__(self, x: np.ndarray, P: np.ndarray) -> None:
        self.x, self.P = x.copy(), P.copy()

    def predict(self, u: np.ndarray, Q: np.ndarray) -> None:
        """u = increment (dx, dy, dtheta) in the body frame, Q its covariance there."""
        x, P = self.x, self.P
        c, s = np.cos(x[2]), np.sin(x[2])
        J = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
        G = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        x[:3] += G @ u
        P[:3, :3] = J @ P[:3, :3] @ J.T + G @ Q @ G.T
        P[:3, 3:] = J @ P[:3, 3:]
        P[3:, :3] = P[:3, 3:].T

    def correct(self, landmark: int, z: np.ndarray, R: np.ndarray) -> None:
        """One range-bearing observation of landmark number ``landmark``."""
        x = self.x
        j = 3 + 2 * landmark
        dx, dy = x[j] - x[0], x[j + 1] - x[1]
        r2 = dx * dx + dy * dy
        r = np.sqrt(r2)
        H = np.zeros((2, x.size))
        H[0, :2], H[0, j : j + 2] = (-dx / r, -dy / r), (dx / r, dy / r)
        H[1, :3], H[1, j : j + 2] = (dy / r2, -dx / r2, -1), (-dy / r2, dx / r2)
        y = z - np.array([r, np.arctan2(dy, dx) - x[2]])
        y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
        PHt = self.P @ H.T
        S = H @ PHt + R
        K = PHt @ np.linalg.inv(S)
        self.x = x + K @ y
        self.P = self.P - K @ (H @ self.P)
