"""Odometry alone: the composed increments, with the covariance that many noisy copies of them show."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp import geometry as g
from slamcmp.backends.dead_reckoning import DeadReckoning
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Frame, Problem

NONE = np.empty(0, dtype=np.int64)


@pytest.mark.parametrize("n", [2, 3])
def test_pose_is_the_product_and_covariance_that_of_many_copies(n: int) -> None:
    """4000 copies of five steps; a sample covariance is within 5 / sqrt(4000) of its value, whitened."""
    p = 3 if n == 2 else 6
    rng = np.random.default_rng(6)
    sensor = make_sensor("relative_position", {"space_dim": n})
    steps, prior_P = g.exp(0.4 * rng.normal(size=(5, p))), np.diag(1e-3 * rng.uniform(1, 2, p)) ** 2
    Q = np.array([np.diag(2e-3 * rng.uniform(1, 2, p)) ** 2 for _ in steps])
    back_end, true = DeadReckoning(Problem(np.eye(n + 1), prior_P, sensor)), np.eye(n + 1)
    copies = g.exp(rng.normal(size=(4000, p)) * np.sqrt(np.diag(prior_P)))
    for k in range(6):
        T, noise = (steps[k - 1], Q[k - 1]) if k else (np.eye(n + 1), np.zeros((p, p)))
        back_end.update(Frame(k, float(k), T, noise, NONE, np.empty((0, n)), np.empty((0, n, n))))
        true = true @ T
        copies = copies @ T @ g.exp(rng.normal(size=(4000, p)) * np.sqrt(np.diag(noise)))
    estimate = back_end.estimate()
    np.testing.assert_allclose(estimate.T_world_body, true, atol=1e-14)
    errors = np.linalg.solve(np.linalg.cholesky(estimate.P), g.log(g.inverse(true) @ copies).T)
    np.testing.assert_allclose(errors @ errors.T / 4000, np.eye(p), atol=5 * np.sqrt(2 / 4000))
