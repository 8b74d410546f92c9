"""Kalman filter for x_{t+1} = A x_t + w, y_t = C x_t + v (Thrun, Burgard, Fox 2005, table 3.1)."""

import numpy as np


def predict(mean, covariance, A, process_noise):
    """Mean and covariance of the state at t+1, given observations up to t."""
    mean_next = A @ mean
    covariance_next = A @ covariance @ A.T + process_noise
    return mean_next, covariance_next


def correct(mean, covariance, y, C, measurement_noise):
    """Mean and covariance of the state, given also the observation y."""
    innovation = y - C @ mean
    innovation_covariance = C @ covariance @ C.T + measurement_noise
    gain = np.linalg.solve(innovation_covariance, C @ covariance).T
    mean_new = mean + gain @ innovation
    covariance_new = covariance - gain @ C @ covariance
    return mean_new, (covariance_new + covariance_new.T) / 2


def run_filter(mean, covariance, measurements, A, C, process_noise, measurement_noise):
    """Means (K, n) and covariances (K, n, n) after each of K observations; a row of NaN is no observation."""
    means, covariances = [], []
    for t, y in enumerate(measurements):
        if t > 0:
            mean, covariance = predict(mean, covariance, A, process_noise)
        if np.isfinite(y).all():
            mean, covariance = correct(mean, covariance, y, C, measurement_noise)
        means.append(mean)
        covariances.append(covariance)
    return np.array(means), np.array(covariances)
