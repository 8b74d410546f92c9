"""Information form: inverses of covariances add up."""

import numpy as np


def correct(mean, covariance, y, C, measurement_noise):
    weight = C.T @ np.linalg.inv(measurement_noise)
    information = np.linalg.inv(covariance)
    covariance_new = np.linalg.inv(information + weight @ C)
    return covariance_new @ (information @ mean + weight @ y), covariance_new
