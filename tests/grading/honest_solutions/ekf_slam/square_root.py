"""Triangular factors by QR in the update: no covariance is subtracted."""

import numpy as np

from slamcmp.geometry import exp


def update(T_world_body, landmarks, P, numbers, z, R):
    H = stacked_jacobian(T_world_body, landmarks, numbers)
    y = SENSOR.residual(z, SENSOR.predict(T_world_body, landmarks[numbers])).ravel()
    m, n = H.shape
    factor = np.linalg.cholesky(P)
    array = np.zeros((m + n, m + n))
    array[:m, :m] = np.linalg.cholesky(block_diagonal(R))
    array[:m, m:] = H @ factor
    array[m:, m:] = factor
    L = np.linalg.qr(array.T, mode="r").T
    step = L[m:, :m] @ np.linalg.solve(L[:m, :m], y)
    return T_world_body @ exp(step[:3]), landmarks + step[3:].reshape(-1, 2), L[m:, m:] @ L[m:, m:].T
