"""Intervals and tests over runs: hand-computed values, scipy as a second opinion, and coverage."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from slamcmp.errors import UsageError
from slamcmp.metrics.statistics import (
    EXACT_PAIRS,
    average_nees,
    bootstrap_interval,
    median_interval,
    paired_interval,
    sign_test,
    signed_rank_test,
    wilson_interval,
)


@pytest.mark.parametrize(
    # Ranks of the 95 % interval from the binomial table (Conover 1999, table A3).
    ("runs", "rank"),
    [(6, 1), (8, 1), (9, 2), (10, 2), (12, 3), (20, 6), (50, 18), (100, 40)],
)
def test_median_interval_lies_between_the_tabulated_order_statistics(runs, rank):
    found = median_interval(np.random.default_rng(runs).permutation(np.arange(1.0, runs + 1)))
    assert (found.low, found.high, found.runs) == (rank, runs + 1 - rank, runs)
    assert found.estimate == (runs + 1) / 2
    assert found.half_width == (runs + 1 - 2 * rank) / 2


def test_median_interval_needs_six_runs():
    found = median_interval([1.0, 2.0, 3.0, 4.0, 50.0, math.nan, math.inf])
    assert (found.estimate, found.runs) == (3.0, 5)
    assert math.isnan(found.low)
    assert found.half_width == math.inf
    # 1 - 2/32 = 93.75 % is what five values can give.
    assert (median_interval(np.arange(5.0), 0.93).low, median_interval(np.arange(5.0), 0.93).high) == (0, 4)
    assert median_interval([]).runs == 0


@pytest.mark.parametrize("runs", [7, 20])
def test_median_interval_covers_as_the_binomial_says(runs):
    rng = np.random.default_rng(3)
    samples = np.exp(1.5 * rng.normal(size=(4000, runs)))
    found = [median_interval(sample) for sample in samples]
    share = np.mean([each.low <= 1.0 <= each.high for each in found])
    rank = 1 if runs == 7 else 6
    expected = 1.0 - 2.0 * stats.binom.cdf(rank - 1, runs, 0.5)
    # Four standard deviations of the share over 4000 samples.
    assert abs(share - expected) < 4 * math.sqrt(expected * (1 - expected) / 4000)


def test_bootstrap_interval_agrees_with_scipy():
    sample = np.random.default_rng(1).exponential(size=40)
    found = bootstrap_interval(sample, resamples=20_000)
    theirs = stats.bootstrap((sample,), np.mean, n_resamples=20_000, method="BCa", rng=2)
    assert found.estimate == sample.mean()
    # The bounds' own Monte-Carlo deviation is 0.005 at 20 000 resamples.
    assert found.low == pytest.approx(theirs.confidence_interval.low, abs=0.02)
    assert found.high == pytest.approx(theirs.confidence_interval.high, abs=0.02)
    assert found == bootstrap_interval(sample, resamples=20_000)


def test_bootstrap_interval_covers_the_mean_of_a_skewed_distribution():
    rng = np.random.default_rng(4)
    found = [bootstrap_interval(rng.exponential(size=30), resamples=1000, seed=i) for i in range(1000)]
    share = np.mean([each.low <= 1.0 <= each.high for each in found])
    # Known to fall a little short at 30 skewed values; plus and minus four deviations (0.007) around 0.93.
    assert 0.90 < share < 0.96


def test_bootstrap_interval_of_equal_or_few_values():
    assert bootstrap_interval([2.0, 2.0, 2.0, 2.0]).half_width == 0.0
    assert math.isnan(bootstrap_interval([1.0, 2.0]).low)
    assert bootstrap_interval([]).runs == 0


def test_paired_interval_drops_incomplete_pairs():
    reference = np.array([1.0, 2.0, 4.0, math.nan, 5.0, 8.0, 10.0, 2.0])
    values = np.array([2.0, 3.0, math.inf, 1.0, 6.0, 9.0, 11.0, 3.0])
    difference = paired_interval(values, reference)
    assert (difference.estimate, difference.low, difference.high, difference.runs) == (1.0, 1.0, 1.0, 6)
    ratio = paired_interval(values, reference, "ratio")
    # 2, 1.5, 1.2, 1.125, 1.1, 1.5: the smallest and the largest of six.
    assert (ratio.estimate, ratio.low, ratio.high) == (pytest.approx(1.35), pytest.approx(1.1), 2.0)
    with pytest.raises(UsageError, match="a pair is one seed"):
        paired_interval([1.0], [1.0, 2.0])


def test_pairing_narrows_the_interval_of_a_common_spread():
    rng = np.random.default_rng(5)
    world = rng.normal(size=40)
    first, second = world + 0.1 * rng.normal(size=40), world + 0.3 + 0.1 * rng.normal(size=40)
    paired = paired_interval(second, first)
    assert paired.low < 0.3 < paired.high
    assert paired.half_width < 0.25 * median_interval(first).half_width


def test_sign_test_by_hand():
    # One of eight against: 2 (1 + 8) / 256.
    assert sign_test([1, 2, 3, 4, 5, 6, 7, -1, 0, math.nan]) == pytest.approx(18 / 256)
    assert sign_test([1, -1]) == 1.0
    assert math.isnan(sign_test([0.0]))


def test_signed_rank_test_by_hand_and_by_scipy():
    # Ranks 1..5 with 1 negative: sums <= 1 are {} and {1}: 2 · 2 / 32.
    assert signed_rank_test([-1, 2, 3, 4, 5]) == pytest.approx(4 / 32)
    sample = np.random.default_rng(6).normal(0.4, 1.0, size=25)
    assert signed_rank_test(sample) == pytest.approx(stats.wilcoxon(sample, method="exact").pvalue, rel=1e-12)
    large = np.random.default_rng(7).normal(0.2, 1.0, size=EXACT_PAIRS + 40)
    theirs = stats.wilcoxon(large, method="approx", correction=False).pvalue
    assert signed_rank_test(large) == pytest.approx(theirs, rel=1e-9)
    for pairs in (EXACT_PAIRS + 1, 80):
        exact = stats.wilcoxon(large[:pairs], method="exact").pvalue
        assert signed_rank_test(large[:pairs]) == pytest.approx(exact, abs=5e-3)


def test_signed_rank_test_with_ties_counts_every_sign_pattern():
    given = np.array([1.0, -1.0, 2.0, 2.0, 2.0, -3.0, 4.0])
    ranks = stats.rankdata(np.abs(given))
    observed = min(ranks[given > 0].sum(), ranks[given < 0].sum())
    sums = [np.dot(signs, ranks) for signs in itertools.product([0, 1], repeat=given.size)]
    assert signed_rank_test(given) == pytest.approx(2 * np.mean(np.array(sums) <= observed))


def test_wilson_interval_agrees_with_scipy_and_is_sensible_at_the_ends():
    for failures, runs in [(3, 20), (10, 20), (19, 20), (0, 10), (10, 10)]:
        found = wilson_interval(failures, runs)
        theirs = stats.binomtest(failures, runs).proportion_ci(method="wilson")
        assert found.estimate == failures / runs
        assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    # Without a failure among N: z²/(N + z²).
    z2 = stats.norm.ppf(0.975) ** 2
    assert wilson_interval(0, 10).high == pytest.approx(z2 / (10 + z2))
    assert wilson_interval(0, 10).low == 0.0
    assert wilson_interval(0, 0).runs == 0


def test_average_nees_has_the_tabulated_band():
    # Chi-square table: 60 degrees of freedom 40.482 and 83.298, 150: 117.985 and 185.800.
    for runs, low, high in [(20, 40.482, 83.298), (50, 117.985, 185.800)]:
        found = average_nees(np.full(runs, 3.0), 3)
        assert (found.low * runs, found.high * runs) == pytest.approx((low, high), abs=1e-3)
        assert found.verdict == "consistent"
    assert average_nees(np.full(20, 4.2), 3).verdict == "overconfident"
    assert average_nees([*np.full(20, 2.0), math.nan], 3).verdict == "underconfident"
    assert average_nees([], 3).verdict == ""


def test_average_nees_of_consistent_runs_is_inside_as_often_as_it_says():
    rng = np.random.default_rng(8)
    inside = np.mean([average_nees(rng.chisquare(3, 20), 3).verdict == "consistent" for _ in range(3000)])
    # Four standard deviations of a share of 0.95 over 3000.
    assert abs(inside - 0.95) < 0.016
