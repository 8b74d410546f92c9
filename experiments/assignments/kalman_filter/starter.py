"""Kalman filter: fill in the three functions and hand in this file as kalman_filter.py.

The system is x_{t+1} = A x_t + w_t with w_t ~ N(0, process_noise), and
y_t = C x_t + v_t with v_t ~ N(0, measurement_noise). The state has n entries, an observation m.
"""

import numpy as np


def predict(mean, covariance, A, process_noise):
    """Propagate: the state at t+1, given observations up to t.

    Args:
        mean: (n,).
        covariance: (n, n).
        A: (n, n).
        process_noise: covariance of w, (n, n).

    Returns:
        mean (n,) and covariance (n, n).
    """
    raise NotImplementedError


def correct(mean, covariance, y, C, measurement_noise):
    """Update: the state, given also the observation y.

    Args:
        mean: (n,).
        covariance: (n, n).
        y: (m,).
        C: (m, n).
        measurement_noise: covariance of v, (m, m); a covariance, not standard deviations.

    Returns:
        mean (n,) and covariance (n, n).
    """
    raise NotImplementedError


def run_filter(mean, covariance, measurements, A, C, process_noise, measurement_noise):
    """Filter a whole sequence.

    The given mean and covariance belong to the time of the first observation, before it is used. A row of
    NaN says that there was no observation at that time.

    Args:
        mean: (n,).
        covariance: (n, n).
        measurements: (K, m).
        A, C, process_noise, measurement_noise: as above.

    Returns:
        means (K, n) and covariances (K, n, n), each after its time's observation.
    """
    raise NotImplementedError
