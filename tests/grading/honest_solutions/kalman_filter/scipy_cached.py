"""scipy's Cholesky solver, and gains that are remembered: the covariance does not depend on what is observed."""

import functools

import numpy as np
import scipy.linalg


@functools.lru_cache(maxsize=1000)
def gain_of(P, C, R, n, m):
    P, C, R = np.frombuffer(P).reshape(n, n), np.frombuffer(C).reshape(m, n), np.frombuffer(R).reshape(m, m)
    factor = scipy.linalg.cho_factor(C @ P @ C.T + R, lower=True)
    K = scipy.linalg.cho_solve(factor, C @ P).T
    return K, P - K @ C @ P


def correct(mean, covariance, y, C, measurement_noise):
    parts = (np.ascontiguousarray(each, dtype=float).tobytes() for each in (covariance, C, measurement_noise))
    K, P = gain_of(*parts, len(mean), len(y))
    return mean + K.dot(np.subtract(y, C.dot(mean))), P
