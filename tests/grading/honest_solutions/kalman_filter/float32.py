"""In single precision throughout."""

import numpy as np


def predict(mean, covariance, A, process_noise):
    mean, covariance, A, process_noise = (
        np.asarray(each, dtype=np.float32) for each in (mean, covariance, A, process_noise)
    )
    return A @ mean, A @ covariance @ A.T + process_noise


def correct(mean, covariance, y, C, measurement_noise):
    mean, covariance, y, C, R = (
        np.asarray(each, dtype=np.float32) for each in (mean, covariance, y, C, measurement_noise)
    )
    S = C @ covariance @ C.T + R
    K = covariance @ C.T @ np.linalg.inv(S)
    return mean + K @ (y - C @ mean), covariance - K @ S @ K.T
