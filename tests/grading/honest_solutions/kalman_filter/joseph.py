"""Joseph form of the covariance, inverse of S written out."""

import numpy as np


def correct(mean, covariance, y, C, measurement_noise):
    S = np.dot(C, np.dot(covariance, C.T)) + measurement_noise
    K = np.dot(covariance, np.dot(C.T, np.linalg.inv(S)))
    left = np.identity(len(mean)) - np.dot(K, C)
    return mean + np.dot(K, y - np.dot(C, mean)), left @ covariance @ left.T + K @ measurement_noise @ K.T
