"""Divergence of Gaussians and drift of linearisation points against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slamcmp import geometry
from slamcmp.errors import DataError
from slamcmp.metrics.information import (
    kl_divergence,
    landmark_drift,
    pose_drift,
    posterior_difference,
    posterior_kl,
)
from slamcmp.results.runs.posteriors import Posterior, kl_series
from slamcmp.types import Landmarks


def definite(seed: int, size: int) -> np.ndarray:
    square = np.random.default_rng(seed).normal(size=(size, size))
    return square @ square.T + np.eye(size)


def test_scalar_gaussians() -> None:
    """KL(N(1, 2²) || N(3, 5²)) = ln(5/2) + (4 + 4) / 50 - 1/2."""
    value = kl_divergence(np.array([1.0]), np.array([[4.0]]), np.array([3.0]), np.array([[25.0]]))
    assert value == pytest.approx(math.log(2.5) + 8 / 50 - 0.5, rel=1e-14)


def test_textbook_formula_in_five_dimensions() -> None:
    A, B = definite(0, 5), definite(1, 5)
    a, b = np.random.default_rng(2).normal(size=(2, 5))
    expected = 0.5 * (
        np.trace(np.linalg.solve(B, A))
        - 5
        + (b - a) @ np.linalg.solve(B, b - a)
        + np.linalg.slogdet(B)[1]
        - np.linalg.slogdet(A)[1]
    )
    assert kl_divergence(a, A, b, B) == pytest.approx(expected, rel=1e-12)


def test_does_not_depend_on_units_and_vanishes_for_equals() -> None:
    A, B = definite(0, 6), definite(1, 6)
    a, b = np.random.default_rng(2).normal(size=(2, 6))
    units = np.array([1e6, 1e-6, 1.0, 1e3, 1e-3, 1e-8])
    scaled = kl_divergence(a * units, A * np.outer(units, units), b * units, B * np.outer(units, units))
    assert scaled == pytest.approx(kl_divergence(a, A, b, B), rel=1e-10)
    assert kl_divergence(a, A, a, A) == pytest.approx(0.0, abs=1e-14)


def test_overconfidence_costs_more_than_caution() -> None:
    """Variance ratio q: ½ (q - 1 - ln q) for n = 1; a reference four times too sure 0.81, too shy 0.32."""
    one, four = np.eye(1), 4 * np.eye(1)
    zero = np.zeros(1)
    assert kl_divergence(zero, four, zero, one) == pytest.approx(0.5 * (3 - math.log(4)), rel=1e-14)
    assert kl_divergence(zero, one, zero, four) == pytest.approx(0.5 * (math.log(4) - 0.75), rel=1e-14)


def test_an_indefinite_covariance_is_named() -> None:
    with pytest.raises(DataError, match="reference: a covariance is not positive definite"):
        kl_divergence(np.zeros(2), np.eye(2), np.zeros(2), np.diag([1.0, -1.0]))


def test_posteriors_are_compared_on_the_landmarks_they_share() -> None:
    T = geometry.se2(1.0, 2.0, math.pi / 2)
    # One metre ahead in the body's own frame, and turned by 0.1.
    T_reference = T @ geometry.exp(np.array([1.0, 0.0, 0.1]))
    ours = Landmarks(np.array([7, 3, 5]), np.array([[0.0, 0], [1, 1], [2, 2]]), np.tile(np.eye(2), (3, 1, 1)))
    theirs = Landmarks(
        np.array([5, 9, 7]), np.array([[2.5, 2], [8, 8], [0, 1]]), np.tile(np.eye(2), (3, 1, 1))
    )
    difference, mine, other = posterior_difference(T, ours, T_reference, theirs)
    np.testing.assert_allclose(difference, [1.0, 0.0, 0.1, 0.5, 0.0, 0.0, 1.0], atol=1e-12)
    assert mine.tolist() == [0, 1, 2, 7, 8, 3, 4]
    assert other.tolist() == [0, 1, 2, 3, 4, 7, 8]
    joint, joint_reference = definite(3, 9), definite(4, 9)
    expected = kl_divergence(
        np.zeros(7), joint[np.ix_(mine, mine)], difference, joint_reference[np.ix_(other, other)]
    )
    value = posterior_kl(T, ours, joint, T_reference, theirs, joint_reference)
    assert value == pytest.approx(expected, rel=1e-14)
    assert posterior_kl(T, ours, joint, T, ours, joint) == pytest.approx(0.0, abs=1e-13)


def test_beliefs_are_compared_at_equal_frames() -> None:
    """Frames 1 and 3 are known to both; what lies beyond the log, or is singular, has no value."""
    landmarks = Landmarks(np.array([7]), np.zeros((1, 2)), np.eye(2)[None])

    def at(k: int, variance: float) -> Posterior:
        return Posterior(k, np.eye(3), landmarks, variance * np.eye(5))

    own = [at(k, 1.0) for k in (1, 2, 3, 9)] + [at(0, 0.0)]
    series = kl_series(own, [at(3, 4.0), at(1, 1.0), at(9, 1.0), at(0, 1.0)], 5)
    assert np.isnan(series[[0, 2, 4]]).all()
    assert series[1] == pytest.approx(0.0, abs=1e-14)
    # Five times ½ (1/4 - 1 + ln 4), and not the other way round.
    assert series[3] == pytest.approx(2.5 * (math.log(4) - 0.75), rel=1e-13)


def test_drift_of_poses_and_landmarks() -> None:
    a = geometry.se2([0.0, 1.0], [0.0, 1.0], [0.0, 3.0])
    b = geometry.se2([3.0, 1.0], [4.0, 1.0], [0.2, -3.0])
    shift, turn = pose_drift(a, b)
    np.testing.assert_allclose(shift, [5.0, 0.0])
    np.testing.assert_allclose(turn, [0.2, 2 * math.pi - 6.0])
    spatial = geometry.exp(np.array([0.0, 0.3, 0.4, 0.0, 0.0, 0.0]))
    shift, turn = pose_drift(np.eye(4), spatial)
    assert (shift, turn) == (0.0, pytest.approx(0.5))
    np.testing.assert_allclose(
        landmark_drift(np.zeros((2, 2)), np.array([[3.0, 4.0], [0.0, 2.0]])), [5.0, 2.0]
    )


@pytest.mark.parametrize("leading", [(), (2,), (4, 2)])
def test_drift_of_landmarks_is_a_distance_for_any_leading_axes(leading: tuple[int, ...]) -> None:
    before = np.zeros((*leading, 3))
    np.testing.assert_allclose(
        landmark_drift(before, before + np.array([2.0, 3.0, 6.0])), np.full(leading, 7.0)
    )
