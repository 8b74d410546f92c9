"""Run next to your kalman_filter.py: python public_tests.py. The expected numbers are worked out by hand."""

import numpy as np
from kalman_filter import correct, predict, run_filter

ONE = np.array([[1.0]])


def test_predict():
    A = np.array([[1.0, 1.0], [0.0, 1.0]])
    mean, covariance = predict(np.array([1.0, 2.0]), np.diag([1.0, 4.0]), A, np.diag([0.5, 0.25]))
    np.testing.assert_allclose(mean, [3.0, 2.0])
    np.testing.assert_allclose(covariance, [[5.5, 4.0], [4.0, 4.25]])


def test_correct():
    # As sure of the prior as of the observation: the estimate lies half-way.
    mean, covariance = correct(np.array([0.0]), 2.0 * ONE, np.array([3.0]), ONE, 2.0 * ONE)
    np.testing.assert_allclose(mean, [1.5])
    np.testing.assert_allclose(covariance, [[1.0]])


def test_run_filter():
    # The second observation is missing, so only the process noise (1) is added there.
    measurements = np.array([[2.0], [np.nan]])
    means, covariances = run_filter(np.array([0.0]), ONE, measurements, ONE, ONE, ONE, ONE)
    np.testing.assert_allclose(means, [[1.0], [1.0]])
    np.testing.assert_allclose(covariances, [[[0.5]], [[1.5]]])


if __name__ == "__main__":
    for test in (test_predict, test_correct, test_run_filter):
        test()
        print(f"{test.__name__}: ok")
