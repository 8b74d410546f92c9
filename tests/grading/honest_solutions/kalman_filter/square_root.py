"""Square-root filter: triangular factors by QR, no covariance is ever subtracted (Kaminski et al. 1971)."""

import numpy as np


def predict(mean, covariance, A, process_noise):
    stacked = np.vstack([(A @ np.linalg.cholesky(covariance)).T, np.linalg.cholesky(process_noise).T])
    R = np.linalg.qr(stacked, mode="r")
    return A @ mean, R.T @ R


def correct(mean, covariance, y, C, measurement_noise):
    n, m = len(mean), len(y)
    factor = np.linalg.cholesky(covariance)
    array = np.zeros((m + n, m + n))
    array[:m, :m] = np.linalg.cholesky(measurement_noise)
    array[:m, m:] = C @ factor
    array[m:, m:] = factor
    L = np.linalg.qr(array.T, mode="r").T
    step = L[m:, :m] @ np.linalg.solve(L[:m, :m], y - C @ mean)
    return mean + step, L[m:, m:] @ L[m:, m:].T
