"""What all matches of one image say together about the motion since the last one.

Odometry's error moves every predicted point at once, so that each one's own window must be wide, and a wrong
match beside the right one passes. The error that all have in common is estimated here, robustly; what is
left is each point's own, and the Mahalanobis test becomes sharp. It serves the front end's predictions only:
the stream carries the odometry as it was measured.

========  ==========================================================================
symbol    meaning
========  ==========================================================================
xi        error of the increment in the body tangent, T_true = T exp(xi), (6,)
Q         its covariance by odometry, (6, 6)
y, S      innovations (m, d) and their covariances without Q's part, (m, d, d)
H         derivative of the measurement by the body's pose, (m, d, 6)
w         weight of each match by Cauchy's function, (m,)
========  ==========================================================================
"""

from __future__ import annotations

import numpy as np

from slamcmp.types import FloatArray

_ROUNDS = 6


def common_motion(
    y: FloatArray, S: FloatArray, H: FloatArray, Q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """xi (6,) and its covariance (6, 6) given the innovations: maximum a posteriori, prior N(0, Q)."""
    d = y.shape[1]
    weighted = np.linalg.solve(S, np.concatenate([H, y[:, :, None]], axis=2))
    weighted_H, weighted_y = weighted[:, :, :6], weighted[:, :, 6]
    each_A = (H.mT @ weighted_H).reshape(-1, 36)
    each_b = (H.mT @ weighted_y[:, :, None])[:, :, 0]
    # One product for all matches, not one for each.
    flat_H, flat_weighted_H = H.reshape(-1, 6), weighted_H.reshape(-1, 6)
    flat_y, flat_weighted_y = y.ravel(), weighted_y.ravel()
    xi, w = np.zeros(6), np.ones(len(y))
    covariance, identity = Q, np.eye(6)
    for _ in range(_ROUNDS):
        # Solved without Q's inverse, for it may be singular.
        A = identity + Q @ (w @ each_A).reshape(6, 6)
        covariance = np.asarray(np.linalg.solve(A, Q), dtype=np.float64)
        xi = covariance @ (w @ each_b)
        squared = (flat_y - flat_H @ xi) * (flat_weighted_y - flat_weighted_H @ xi)
        squared = squared.reshape(y.shape).sum(axis=1)
        w = 1.0 / (1.0 + squared / (2.0 * d))
    return xi, 0.5 * (covariance + covariance.T)
