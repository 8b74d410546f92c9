"""numpy's old matrix class, in which * is the product; matrices come back."""

import numpy as np


def predict(mean, covariance, A, process_noise):
    A, m, P = np.matrix(A), np.matrix(mean).T, np.matrix(covariance)
    return (A * m).A1, A * P * A.T + process_noise


def correct(mean, covariance, y, C, measurement_noise):
    C, m, P, R = np.matrix(C), np.matrix(mean).T, np.matrix(covariance), np.matrix(measurement_noise)
    K = P * C.T * (C * P * C.T + R).I
    return (m + K * (np.matrix(y).T - C * m)).A1, (np.matrix(np.eye(len(m))) - K * C) * P
