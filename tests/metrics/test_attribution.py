"""Parts of a gap: exact sums, and intervals of medians with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from slamcmp.errors import DataError
from slamcmp.metrics.attribution import median_interval, telescoped


def test_parts_by_hand_and_their_sum() -> None:
    scores = np.array([[5.0, 4.0, 4.5, 1.0], [2.0, 2.5, 2.5, 2.0]])
    parts = telescoped(scores)
    np.testing.assert_allclose(parts, [[1.0, -0.5, 3.5], [-0.5, 0.0, 0.5]])
    np.testing.assert_allclose(parts.sum(axis=1), [4.0, 0.0])


def test_one_stage_has_no_gap() -> None:
    with pytest.raises(DataError, match="at least 2 stages"):
        telescoped(np.ones((3, 1)))


def test_median_interval_covers_the_median_as_often_as_it_says() -> None:
    """400 samples of 25 normal draws: coverage within 3 sigma of 0.95, plus 2 % for the small sample."""
    rng = np.random.default_rng(0)
    hits = 0
    for seed in range(400):
        interval = median_interval(rng.normal(1.0, 2.0, 25), seed=seed)
        hits += interval.low <= 1.0 <= interval.high
    assert abs(hits / 400 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 400) + 0.02


def test_median_interval_of_equal_values_is_a_point() -> None:
    interval = median_interval(np.full(5, 3.0))
    assert (interval.median, interval.low, interval.high) == (3.0, 3.0, 3.0)


def test_values_must_be_finite() -> None:
    with pytest.raises(DataError, match="all finite"):
        median_interval(np.array([1.0, np.nan]))
