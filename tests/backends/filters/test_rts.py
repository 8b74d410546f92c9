"""RTS smoothing: all batch marginals on linear problems, and sense on nonlinear ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamcmp.backends.filters.ekf_slam import EkfSlam
from slamcmp.backends.filters.iterated import IteratedEkf
from slamcmp.backends.filters.kalman import KalmanFilter, KnownHeadingKalmanFilter
from slamcmp.backends.filters.robocentric import RobocentricEkf
from slamcmp.backends.filters.ukf import UkfSlam
from slamcmp.backends.filters.variants import (
    FirstEstimatesEkf,
    IdealEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.errors import UsageError
from slamcmp.types import MeasurementStream
from tests.oracles.filters import maker, run, world_of

FILTERS = (
    WorldEkf,
    FirstEstimatesEkf,
    ObservabilityConstrainedEkf,
    IdealEkf,
    RightInvariantEkf,
    RobocentricEkf,
    IteratedEkf,
    UkfSlam,
)


def linear_stream() -> MeasurementStream:
    """Heading known exactly: every model is linear."""
    return world_of(2, sensor_name="relative_position", heading_sigma=0.0, frames=30, landmarks=8)[0]


def test_kalman_smoother_is_every_marginal_of_the_batch() -> None:
    """x_0..x_K stacked into one least-squares problem; singular prior and noise included."""
    rng = np.random.default_rng(0)
    s, o, steps = 3, 2, 12
    A = [np.eye(s) + 0.3 * rng.normal(size=(s, s)) for _ in range(steps)]
    C = [rng.normal(size=(o, s)) for _ in range(steps)]
    b, y = rng.normal(size=(steps, s)), rng.normal(size=(steps, o))
    Q, R, P0 = np.diag([0.1, 0.3, 0.0]), np.diag([0.5, 0.2]), np.diag([1.0, 0.0, 3.0])
    x0 = np.array([1.0, -2.0, 0.5])
    filter_ = KalmanFilter(x0, P0, smooth=True)
    # All states are affine in the independent (x_0, w_1, …): mean and joint covariance in closed form.
    mean = [x0]
    factors = [np.hstack([np.eye(s), np.zeros((s, s * steps))])]
    for k in range(steps):
        filter_.predict(A[k], Q, b[k])
        filter_.correct(y[k], C[k], R)
        filter_.mark(float(k))
        mean.append(A[k] @ mean[-1] + b[k])
        step = A[k] @ factors[-1]
        step[:, s * (k + 1) : s * (k + 2)] += np.eye(s)
        factors.append(step)
    M = np.concatenate(factors[1:])
    blocks = [P0, *[Q] * steps]
    prior = sum(
        M[:, s * i : s * (i + 1)] @ block @ M[:, s * i : s * (i + 1)].T for i, block in enumerate(blocks)
    )
    C_all = np.zeros((o * steps, s * steps))
    for k in range(steps):
        C_all[o * k : o * (k + 1), s * k : s * (k + 1)] = C[k]
    S = C_all @ prior @ C_all.T + np.kron(np.eye(steps), R)
    gain = np.linalg.solve(S, C_all @ prior).T
    batch = np.concatenate(mean[1:]) + gain @ (y.ravel() - C_all @ np.concatenate(mean[1:]))
    P_batch = prior - gain @ C_all @ prior
    means, P = filter_.smoothed()
    np.testing.assert_allclose(means.ravel(), batch, atol=1e-9)
    for k in range(steps):
        at = slice(s * k, s * (k + 1))
        np.testing.assert_allclose(P[k], P_batch[at, at], atol=1e-9)


def test_smoothed_asks_for_the_history() -> None:
    with pytest.raises(UsageError, match="smooth=True"):
        KalmanFilter(np.zeros(1), np.eye(1)).smoothed()


def test_known_heading_smoother_is_every_marginal_of_the_batch() -> None:
    """Positions and landmarks by one dense least-squares solution in world axes."""
    stream = linear_stream()
    K, R_wb = len(stream.frames), np.eye(2)
    size = 2 * K + 16
    information, vector = np.zeros((size, size)), np.zeros(size)

    def add(J: np.ndarray, r: np.ndarray, noise: np.ndarray) -> None:
        nonlocal information, vector
        information += J.T @ np.linalg.solve(noise, J)
        vector += J.T @ np.linalg.solve(noise, r)

    first = np.eye(2, size)
    add(first, stream.problem.T_world_body[:2, 2], stream.problem.P[:2, :2])
    for frame in stream.frames:
        k = frame.k
        if k:
            J = np.zeros((2, size))
            J[:, 2 * k : 2 * k + 2], J[:, 2 * k - 2 : 2 * k] = np.eye(2), -np.eye(2)
            moved = R_wb @ frame.T_prev_body[:2, 2]
            R_wb = R_wb @ frame.T_prev_body[:2, :2]
            add(J, moved, R_wb @ frame.Q[:2, :2] @ R_wb.T)
        for landmark, z, R in zip(frame.ids, frame.z, frame.R, strict=True):
            J = np.zeros((2, size))
            J[:, 2 * k : 2 * k + 2] = -R_wb.T
            J[:, 2 * K + 2 * landmark : 2 * K + 2 * landmark + 2] = R_wb.T
            add(J, z, R)
    P = np.linalg.inv(information)
    x = P @ vector
    smoothed = run(KnownHeadingKalmanFilter(stream.problem, smooth=True), stream).trajectory()
    np.testing.assert_allclose(smoothed.T_world_body[:, :2, 2].ravel(), x[: 2 * K], atol=1e-9)
    for k in range(K):
        R = smoothed.T_world_body[k, :2, :2]
        block = P[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        np.testing.assert_allclose(smoothed.P[k, :2, :2], R.T @ block @ R, atol=1e-9)


@pytest.mark.parametrize("filter_class", FILTERS)
def test_on_a_linear_problem_every_filters_smoother_is_the_kalman_smoother(filter_class: Any) -> None:
    stream, truth = world_of(2, sensor_name="relative_position", heading_sigma=0.0, frames=30, landmarks=8)
    linear = run(KnownHeadingKalmanFilter(stream.problem, smooth=True), stream).trajectory()
    smoothed = run(maker(filter_class, smooth=True)(stream.problem, truth), stream).trajectory()
    np.testing.assert_allclose(smoothed.T_world_body, linear.T_world_body, atol=1e-9)
    np.testing.assert_allclose(smoothed.P, linear.P, atol=1e-9)


@pytest.mark.parametrize("space_dim", [2, 3])
@pytest.mark.parametrize("filter_class", FILTERS)
def test_hindsight_ends_where_the_filter_is_and_never_knows_less(filter_class: Any, space_dim: int) -> None:
    stream, truth = world_of(space_dim, noise=0.3)
    filter_ = maker(filter_class, smooth=True)(stream.problem, truth)
    online = []
    for frame in stream.frames:
        filter_.update(frame)
        online.append(filter_.estimate())
    smoothed = filter_.trajectory()
    np.testing.assert_allclose(smoothed.T_world_body[-1], online[-1].T_world_body, atol=1e-12)
    np.testing.assert_allclose(smoothed.P[-1], online[-1].P, atol=1e-12)
    traces = np.array([np.trace(estimate.P) for estimate in online])
    assert (np.trace(smoothed.P, axis1=1, axis2=2) <= traces * (1 + 1e-3)).all()


@pytest.mark.parametrize("filter_class", [WorldEkf, RightInvariantEkf, RobocentricEkf])
@pytest.mark.parametrize("settings", [{"space_dim": 2, "seen_at_once": 1}, {"space_dim": 3}])
def test_hindsight_lowers_the_error_over_runs(filter_class: Any, settings: dict[str, int]) -> None:
    """Paired over 12 seeds: the mean squared distance to the truth falls, and in most runs."""
    squares = []
    for seed in range(12):
        stream, truth = world_of(**settings, frames=30, noise=0.5, seed=seed)
        filter_ = maker(filter_class, smooth=True)(stream.problem, truth)
        online = []
        for frame in stream.frames:
            filter_.update(frame)
            online.append(filter_.estimate().T_world_body)
        both = (np.array(online), filter_.trajectory().T_world_body)
        squares.append([np.sum((T - truth.T_world_body)[:, :-1, -1] ** 2) for T in both])
    before, after = np.array(squares).T
    assert after.sum() < 0.95 * before.sum()
    assert np.count_nonzero(after < before) >= 9


def test_rounding_does_not_grow_over_long_runs() -> None:
    """400 frames from an all but exact start: covariances stay positive definite and below the filter's."""
    stream, _ = world_of(2, sensor_name="relative_position", frames=400, landmarks=30, prior_sigma=1e-6)
    for filter_class in (WorldEkf, RightInvariantEkf, RobocentricEkf):
        filter_ = filter_class(stream.problem, smooth=True)
        online = []
        for frame in stream.frames:
            filter_.update(frame)
            online.append(np.diagonal(filter_.estimate().P))
        P = filter_.trajectory().P
        scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        correlation = P / (scale[:, :, None] * scale[:, None, :])
        assert np.linalg.eigvalsh(correlation).min() > 1e-6
        # Heading: its variance does not depend on which mean's axes it is told in.
        assert (scale[:, 2] ** 2 <= np.array(online)[:, 2] * (1 + 1e-6)).all()


def test_smoothing_keeps_the_filters_online_answers(plain_filters: None) -> None:
    stream, _ = world_of(2)
    plain, kept = (run(WorldEkf(stream.problem, smooth=smooth), stream) for smooth in (False, True))
    np.testing.assert_array_equal(plain.estimate().T_world_body, kept.estimate().T_world_body)
    assert plain.history is None
    assert not hasattr(EkfSlam(stream.problem), "trajectory")
