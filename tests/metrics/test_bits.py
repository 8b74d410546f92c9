"""Entropy and logarithmic score against scipy's Gaussians and against what propriety asks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from slamcmp.geometry import retract, se2
from slamcmp.metrics.bits import pose_entropy_bits, pose_log_score_bits


def drawn(p, frames=2000):
    """Start poses, covariances and errors drawn from them."""
    generator = np.random.default_rng(7)
    roots = generator.normal(size=(frames, p, p)) * 0.05
    P = roots @ np.swapaxes(roots, 1, 2) + 1e-4 * np.eye(p)
    xi = np.einsum("kij,kj->ki", np.linalg.cholesky(P), generator.normal(size=(frames, p)))
    size = p // 3 + 2
    return np.broadcast_to(np.eye(size), (frames, size, size)), P, xi


@pytest.mark.parametrize("p", [3, 6])
def test_both_are_those_of_scipys_gaussian(p, truth_of, trajectory_of):
    start, P, xi = drawn(p, 20)
    trajectory, truth = trajectory_of(start, P), truth_of(retract(start, xi))
    gaussians = [multivariate_normal(np.zeros(p), each) for each in P]
    entropy = np.mean([each.entropy() for each in gaussians]) / math.log(2)
    score = np.mean([each.logpdf(e) for each, e in zip(gaussians, xi, strict=True)]) / math.log(2)
    assert pose_entropy_bits(trajectory, truth) == pytest.approx(entropy, rel=1e-9)
    assert pose_log_score_bits(trajectory, truth) == pytest.approx(score, rel=1e-9)


def test_half_the_sigma_is_a_bit_for_each_direction(truth_of, trajectory_of):
    poses = se2(np.zeros(4), 0, 0)
    wide, narrow = (trajectory_of(poses, np.broadcast_to(s**2 * np.eye(3), (4, 3, 3))) for s in (0.2, 0.1))
    truth = truth_of(poses)
    assert pose_entropy_bits(wide, truth) - pose_entropy_bits(narrow, truth) == pytest.approx(3.0)
    # Without an error the score is the density's peak.
    assert pose_log_score_bits(narrow, truth) - pose_log_score_bits(wide, truth) == pytest.approx(3.0)


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
def test_a_claim_that_is_not_honest_loses_bits(factor, truth_of, trajectory_of):
    """The loss is the Kullback-Leibler divergence of the honest Gaussian from the claimed one.

    Of 2000 frames its mean varies by sqrt(p / 2) |1 / factor - 1| / ln 2 / sqrt(2000); four of these.
    """
    start, P, xi = drawn(3)
    truth = truth_of(retract(start, xi))
    honest = pose_log_score_bits(trajectory_of(start, P), truth)
    claimed = pose_log_score_bits(trajectory_of(start, factor * P), truth)
    divergence = 1.5 * (1.0 / factor - 1.0 + math.log(factor)) / math.log(2.0)
    error = 4.0 * math.sqrt(1.5 / 2000) * abs(1.0 / factor - 1.0) / math.log(2.0)
    assert divergence > 0
    assert honest - claimed == pytest.approx(divergence, abs=error)
    # Entropy alone is taken in.
    gained = pose_entropy_bits(trajectory_of(start, P), truth) - pose_entropy_bits(
        trajectory_of(start, factor * P), truth
    )
    assert gained == pytest.approx(-1.5 * math.log2(factor))


def test_frames_without_a_nees_are_left_out(truth_of, trajectory_of):
    poses = se2(np.zeros(3), 0, 0)
    P = np.stack([np.zeros((3, 3)), 0.01 * np.eye(3), 0.01 * np.eye(3)])
    one = trajectory_of(poses[1:], P[1:])
    assert pose_entropy_bits(trajectory_of(poses, P), truth_of(poses)) == pytest.approx(
        pose_entropy_bits(one, truth_of(poses[1:]))
    )
    assert math.isnan(pose_log_score_bits(trajectory_of(poses, np.zeros((3, 3, 3))), truth_of(poses)))
