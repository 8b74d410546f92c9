"""The linear Kalman filter against the closed form: the last-state marginal of the whole batch problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slamcmp.backends.filters.kalman import KalmanFilter, KnownHeadingKalmanFilter
from slamcmp.errors import UsageError
from slamcmp.types import Problem
from tests.toy_stream import toy_stream


def test_equals_the_last_state_marginal_of_the_batch_at_every_step() -> None:
    """Stack x_0..x_k into one least-squares problem, solve, and read off x_k and its covariance."""
    rng = np.random.default_rng(0)
    s, o, steps = 3, 2, 12
    A = [np.eye(s) + 0.3 * rng.normal(size=(s, s)) for _ in range(steps)]
    C = [rng.normal(size=(o, s)) for _ in range(steps)]
    b = rng.normal(size=(steps, s))
    Q, R, P0 = np.diag([0.1, 0.3, 0.2]), np.diag([0.5, 0.2]), np.diag([1.0, 2.0, 3.0])
    x0 = np.array([1.0, -2.0, 0.5])
    y = rng.normal(size=(steps, o))
    filter_ = KalmanFilter(x0, P0)
    information, vector = np.zeros((s * (steps + 1),) * 2), np.zeros(s * (steps + 1))
    information[:s, :s] += np.linalg.inv(P0)
    vector[:s] += np.linalg.solve(P0, x0)
    total = 0.0
    for k in range(steps):
        filter_.predict(A[k], Q, b[k])
        total += filter_.correct(y[k], C[k], R)
        J = np.zeros((s, information.shape[0]))
        J[:, s * k : s * (k + 1)], J[:, s * (k + 1) : s * (k + 2)] = -A[k], np.eye(s)
        information += J.T @ np.linalg.solve(Q, J)
        vector += J.T @ np.linalg.solve(Q, b[k])
        M = np.zeros((o, information.shape[0]))
        M[:, s * (k + 1) : s * (k + 2)] = C[k]
        information += M.T @ np.linalg.solve(R, M)
        vector += M.T @ np.linalg.solve(R, y[k])
        used = s * (k + 2)
        covariance = np.linalg.inv(information[:used, :used])
        mean = covariance @ vector[:used]
        np.testing.assert_allclose(filter_.x, mean[-s:], atol=1e-10)
        np.testing.assert_allclose(filter_.P, covariance[-s:, -s:], atol=1e-11)
    # The sum of squared innovations is the batch problem's chi² at its optimum.
    residuals = mean[:s] - x0
    chi2 = residuals @ np.linalg.solve(P0, residuals)
    for k in range(steps):
        x, x_next = mean[s * k : s * (k + 1)], mean[s * (k + 1) : s * (k + 2)]
        w, v = x_next - A[k] @ x - b[k], y[k] - C[k] @ x_next
        chi2 += w @ np.linalg.solve(Q, w) + v @ np.linalg.solve(R, v)
    assert total == pytest.approx(chi2, rel=1e-10)


def test_refuses_what_is_not_linear() -> None:
    stream, _, _ = toy_stream()
    with pytest.raises(UsageError, match="sensor 'range_bearing' is not linear"):
        KnownHeadingKalmanFilter(stream.problem)
    stream, _, _ = toy_stream(sensor_name="relative_position")
    with pytest.raises(UsageError, match=r"the prior has a heading sigma of 0\.573 deg"):
        KnownHeadingKalmanFilter(stream.problem)


def test_the_heading_s_variance_is_the_prior_s_and_what_the_increments_add() -> None:
    prior, each = 1e-10, 3e-10
    stream, _, _ = toy_stream(sensor_name="relative_position", frames=6)
    problem = Problem(stream.problem.T_world_body, np.diag([1e-4, 1e-4, prior]), stream.problem.sensor)
    filter_ = KnownHeadingKalmanFilter(problem, smooth=True)
    expected = []
    for frame in stream.frames:
        filter_.update(replace(frame, Q=np.diag([1e-4, 1e-4, each if frame.k else 0.0])))
        expected.append(prior + frame.k * each)
        assert filter_.estimate().P[2, 2] == pytest.approx(expected[-1], rel=1e-12)
        assert filter_.joint_covariance()[2, 2] == pytest.approx(expected[-1], rel=1e-12)
    np.testing.assert_allclose(filter_.trajectory().P[:, 2, 2], expected, rtol=1e-12)


def test_is_consistent_over_independent_runs() -> None:
    """ANEES of position over 100 seeds inside the 99.9 % chi² band of 200 degrees of freedom."""
    total = 0.0
    for seed in range(100):
        stream, truth, _ = toy_stream(
            sensor_name="relative_position", heading_sigma=1e-9, seed=seed, frames=40
        )
        linear = KnownHeadingKalmanFilter(stream.problem)
        for frame in stream.frames:
            linear.update(frame)
        estimate = linear.estimate()
        error = estimate.T_world_body[:2, :2].T @ (truth[-1][:2, 2] - estimate.T_world_body[:2, 2])
        total += float(error @ np.linalg.solve(estimate.P[:2, :2], error))
    # chi² quantiles 0.0005 and 0.9995 at 200 degrees of freedom.
    assert 140.66 < total < 272.42
