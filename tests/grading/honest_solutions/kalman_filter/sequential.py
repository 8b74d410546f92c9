"""One number of the observation after the other, made independent by the Cholesky factor of the noise."""

import numpy as np


def correct(mean, covariance, y, C, measurement_noise):
    L = np.linalg.cholesky(measurement_noise)
    for value, row in zip(np.linalg.solve(L, y), np.linalg.solve(L, C)):
        gain = covariance @ row / (row @ covariance @ row + 1.0)
        mean = mean + gain * (value - row @ mean)
        covariance = covariance - np.outer(gain, row @ covariance)
    return mean, covariance
