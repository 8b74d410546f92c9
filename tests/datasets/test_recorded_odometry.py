"""Odometry made for recordings: what is stated is what is drawn, and gaps widen it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamcmp.datasets.images.recorded_odometry import OdometryNoise, increments_between, make_odometry
from slamcmp.errors import UsageError
from slamcmp.geometry import dead_reckoning, exp, local

NOISE = OdometryNoise(0.01, 0.05, 0.5, 2.0, 30.0)


def _drive(count: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    steps = np.tile(np.eye(4), (count, 1, 1))
    steps[1:] = exp(rng.normal(size=(count - 1, 6)) * [0.02, 0.02, 0.1, 0.4, 0.1, 0.05])
    return dead_reckoning(exp(rng.normal(size=6)), steps)


def test_the_drawn_noise_has_the_stated_covariance() -> None:
    """The mean of 12 000 squared normals lies within 0.06 of 1 (4.6 sigma)."""
    truth = _drive(2001)
    t = np.arange(2001) * 0.1
    increments, Q = make_odometry(
        "corrupted_truth", t, NOISE, np.random.default_rng(1), truth=truth, recorded=None
    )
    np.testing.assert_array_equal(increments[0], np.eye(4))
    assert not Q[0].any()
    error = local(increments_between(truth)[1:], increments[1:])
    sigmas = np.sqrt(np.diagonal(Q[1:], axis1=1, axis2=2))
    assert np.mean((error / sigmas) ** 2) == pytest.approx(1.0, abs=0.06)
    assert np.array_equal(Q, np.swapaxes(Q, 1, 2))


def test_stated_sigmas_by_hand() -> None:
    """A step of 2 m in the usual 0.1 s; then 0.4 m in 0.4 s, four times as long."""
    truth = np.tile(np.eye(4), (4, 1, 1))
    truth[:, 0, 3] = [0.0, 2.0, 4.0, 4.4]
    t = np.array([0.0, 0.1, 0.2, 0.6])
    _, Q = make_odometry("recorded", t, NOISE, np.random.default_rng(0), truth=None, recorded=truth)
    np.testing.assert_allclose(Q[1, 3:, 3:], (0.01**2 + (0.05 * 2.0) ** 2) * np.eye(3), rtol=1e-12)
    np.testing.assert_allclose(Q[3, 3:, 3:], (4 * 0.01**2 + (0.05 * 0.4) ** 2) * np.eye(3), rtol=1e-12)
    np.testing.assert_allclose(Q[1, :3, :3], math.radians(0.5) ** 2 * np.eye(3), rtol=1e-12)
    np.testing.assert_allclose(Q[3, :3, :3], 4 * math.radians(0.5) ** 2 * np.eye(3), rtol=1e-12)


def test_standing_moves_nothing_and_a_gap_weakens_it() -> None:
    t = np.array([0.0, 0.1, 1.1])
    increments, Q = make_odometry(
        "constant_position", t, NOISE, np.random.default_rng(0), truth=_drive(3), recorded=None
    )
    np.testing.assert_array_equal(increments, np.tile(np.eye(4), (3, 1, 1)))
    np.testing.assert_allclose(np.sqrt(np.diag(Q[1])), [math.radians(3.0)] * 3 + [0.2] * 3, rtol=1e-12)
    np.testing.assert_allclose(Q[2], 100.0 * Q[1], rtol=1e-12)


def test_recorded_increments_lead_back_to_the_poses() -> None:
    poses = _drive(50)
    increments, _ = make_odometry(
        "recorded", np.arange(50.0), NOISE, np.random.default_rng(0), truth=None, recorded=poses
    )
    np.testing.assert_allclose(dead_reckoning(poses[0], increments), poses, atol=1e-12)


def test_poses_that_are_not_there() -> None:
    t, generator = np.arange(3.0), np.random.default_rng(0)
    with pytest.raises(UsageError, match=r"corrupted_truth needs ground truth.*constant_position needs none"):
        make_odometry("corrupted_truth", t, NOISE, generator, truth=None, recorded=None)
    with pytest.raises(UsageError, match="recorded needs recorded odometry"):
        make_odometry("recorded", t, NOISE, generator, truth=_drive(3), recorded=None)
