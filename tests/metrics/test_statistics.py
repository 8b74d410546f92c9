"""Intervals and tests over runs: hand-computed values, scipy as a second opinion, and coverage."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest
from scipy import stats

from slamcmp.errors import UsageError
from slamcmp.metrics.statistics import (
    EXACT_PAIRS,
    FEWEST_FOR_MEAN,
    FEWEST_RATIOS,
    Interval,
    average_nees,
    mean_interval,
    median_interval,
    paired_interval,
    ratio_interval,
    ratio_test,
    share_interval,
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


def test_mean_interval_inverts_the_cubic_transform():
    sample = np.random.default_rng(1).exponential(size=FEWEST_FOR_MEAN)
    found = mean_interval([*sample, math.nan])
    assert (found.estimate, found.runs) == (pytest.approx(sample.mean()), FEWEST_FOR_MEAN)
    skewness, n = stats.skew(sample, bias=False), sample.size

    def transform(mean: float) -> float:
        t = (sample.mean() - mean) / sample.std(ddof=1)
        return math.sqrt(n) * (t + skewness * t**2 / 3 + skewness**2 * t**3 / 27 + skewness / (6 * n))

    quantile = stats.t.ppf(0.975, n - 1)
    assert [transform(found.low), transform(found.high)] == pytest.approx([quantile, -quantile], rel=1e-9)
    # Skewed to the right: more room above.
    assert found.high - found.estimate > 1.1 * (found.estimate - found.low)


def test_mean_interval_is_students_where_nothing_is_skewed():
    half = np.random.default_rng(2).normal(size=FEWEST_FOR_MEAN)
    sample = 3 + np.concatenate([half, -half])
    theirs = stats.ttest_1samp(sample, 0.0).confidence_interval(0.95)
    found = mean_interval(sample)
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), rel=1e-9)
    assert mean_interval(np.full(60, 2.0)).half_width == 0.0


def test_there_is_no_interval_of_a_mean_that_few_runs_decide():
    found = mean_interval(np.random.default_rng(3).exponential(size=FEWEST_FOR_MEAN - 1))
    assert math.isnan(found.low)
    assert found.half_width == math.inf
    assert found.runs == FEWEST_FOR_MEAN - 1
    assert math.isnan(mean_interval([]).estimate)


def test_ratio_interval_and_its_test_are_students_on_the_logarithm():
    rng = np.random.default_rng(4)
    reference = rng.exponential(size=12)
    values = 1.3 * reference * np.exp(0.4 * rng.normal(size=12))
    theirs = stats.ttest_1samp(np.log(values / reference), 0.0)
    found = ratio_interval([*values, 0.0, math.nan], [*reference, 1.0, 1.0])
    bounds = np.exp(theirs.confidence_interval(0.95))
    assert found.runs == 12
    assert [found.low, found.high] == pytest.approx(bounds)
    assert found.estimate == pytest.approx(stats.gmean(values) / stats.gmean(reference))
    assert ratio_test(values, reference) == pytest.approx(theirs.pvalue, rel=1e-9)
    # Either way round it is the same comparison.
    other = ratio_interval(reference, values)
    assert (other.low, other.high) == pytest.approx((1 / found.high, 1 / found.low))
    assert ratio_test(reference, values) == pytest.approx(ratio_test(values, reference))
    assert math.isnan(ratio_interval(values[:4], reference[:4]).low)
    assert math.isnan(ratio_test(values[:4], reference[:4]))
    assert ratio_interval([], []).runs == 0


def test_the_ratio_is_significant_exactly_where_its_interval_leaves_one_out():
    rng = np.random.default_rng(5)
    for _ in range(200):
        values = np.exp(rng.normal(0.3, 0.5, size=8))
        found = ratio_interval(values, np.ones(8))
        assert (ratio_test(values, np.ones(8)) < 0.05) == (not found.low <= 1.0 <= found.high)
    assert ratio_test(np.full(6, 2.0), np.full(6, 2.0)) == 1.0
    assert ratio_test(np.full(6, 2.0), np.full(6, 1.0)) == 0.0


# Errors as runs have them, with their means: from normal to a standard deviation as large as the mean.
ERRORS = {
    "normal": (lambda rng, size: rng.normal(5.0, 1.0, size), 5.0),
    "Rayleigh": (lambda rng, size: rng.rayleigh(1.0, size), math.sqrt(math.pi / 2)),
    "lognormal": (lambda rng, size: np.exp(0.5 * rng.normal(size=size)), math.exp(0.125)),
    "gamma": (lambda rng, size: rng.gamma(2.0, 1.0, size), 2.0),
    "exponential": (lambda rng, size: rng.exponential(1.0, size), 1.0),
    "one in ten lost": (
        lambda rng, size: np.exp(0.3 * rng.normal(size=size)) * np.where(rng.random(size) < 0.1, 3.0, 1.0),
        1.2 * math.exp(0.045),
    ),
}
# Logarithms of ratios, with their means.
LOG_RATIOS = {
    "normal": (lambda rng, size: 0.3 * rng.normal(size=size), 0.0),
    "Laplace": (lambda rng, size: rng.laplace(size=size), 0.0),
    "Student, 3": (lambda rng, size: rng.standard_t(3, size=size), 0.0),
    "of two Rayleighs": (
        lambda rng, size: np.log(rng.rayleigh(1.0, size)) - np.log(rng.rayleigh(1.0, size)),
        0.0,
    ),
    "of a gamma": (lambda rng, size: np.log(rng.gamma(2.0, 1.0, size)), 1.0 - np.euler_gamma),
    "of an exponential": (lambda rng, size: np.log(rng.exponential(1.0, size)), -np.euler_gamma),
}


def covered(intervals: Iterable[Interval], truth: float) -> float:
    return float(np.mean([each.low <= truth <= each.high for each in intervals]))


def mean_coverage(name: str, runs: int, samples: int) -> float:
    draw, mean = ERRORS[name]
    return covered(map(mean_interval, draw(np.random.default_rng(runs), (samples, runs))), mean)


def ratio_coverage(name: str, runs: int, samples: int) -> float:
    draw, mean = LOG_RATIOS[name]
    ratios, ones = np.exp(draw(np.random.default_rng(runs), (samples, runs))), np.ones(runs)
    return covered((ratio_interval(each, ones) for each in ratios), math.exp(mean))


@pytest.mark.parametrize("name", ["lognormal", "exponential"])
def test_mean_interval_covers_what_it_says(name):
    # Four standard deviations of a share of 0.95 over 1500 beyond 0.93 and 0.97.
    assert 0.907 < mean_coverage(name, FEWEST_FOR_MEAN, 1500) < 0.993


@pytest.mark.parametrize(("name", "runs"), [("normal", 5), ("of a gamma", 5), ("of two Rayleighs", 12)])
def test_ratio_interval_covers_what_it_says(name, runs):
    assert 0.907 < ratio_coverage(name, runs, 1500) < 0.993


@pytest.mark.slow
@pytest.mark.parametrize("runs", [FEWEST_FOR_MEAN, 70, 100, 200])
@pytest.mark.parametrize("name", ERRORS)
def test_mean_interval_covers_93_to_97_percent(name, runs):
    # Two standard deviations of a share over 20 000 are 0.003.
    assert 0.927 < mean_coverage(name, runs, 20_000) < 0.973


@pytest.mark.slow
@pytest.mark.parametrize("runs", [FEWEST_RATIOS, 6, 8, 12, 20, 50])
@pytest.mark.parametrize("name", LOG_RATIOS)
def test_ratio_interval_covers_93_to_97_percent(name, runs):
    assert 0.927 < ratio_coverage(name, runs, 20_000) < 0.973


@pytest.mark.slow
@pytest.mark.parametrize("runs", [6, 7, 8, 10, 12, 20, 50])
def test_median_interval_covers_at_least_what_it_says(runs):
    """Whatever the distribution; between two ranks there is nothing, so small samples cover more."""
    for name in ("normal", "exponential", "one in ten lost"):
        draw, _ = ERRORS[name]
        rng = np.random.default_rng(runs)
        median = float(np.median(draw(rng, 4_000_000)))
        assert covered(map(median_interval, draw(rng, (10_000, runs))), median) > 0.94


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


def test_share_of_a_gain_is_fiellers_interval():
    """The bounds are the shares at which Student's test of part - share * whole is just at 5 %."""
    rng = np.random.default_rng(8)
    whole = 0.4 + 0.1 * rng.normal(size=12)
    part = 0.8 * whole + 0.05 * rng.normal(size=12)
    found = share_interval(part, whole)
    assert found.estimate == pytest.approx(part.mean() / whole.mean())
    for bound in (found.low, found.high):
        assert stats.ttest_1samp(part - bound * whole, 0.0).pvalue == pytest.approx(0.05)
    assert share_interval(part[:4], whole[:4]).half_width == math.inf
    # What is no gain has no share.
    assert share_interval(part, whole - whole.mean() + 0.001).half_width == math.inf
    with pytest.raises(UsageError, match="paired"):
        share_interval(part, whole[1:])


@pytest.mark.parametrize("runs", [6, 20])
def test_share_of_a_gain_covers_for_relative_gains_of_skewed_errors(runs):
    rng = np.random.default_rng(runs)
    hits = []
    for _ in range(1500):
        rts, batch = (1 - mean * np.exp(0.3 * rng.normal(size=runs)) for mean in (0.6, 0.5))
        found = share_interval(rts, batch)
        true = (1 - 0.6 * math.exp(0.045)) / (1 - 0.5 * math.exp(0.045))
        hits.append(found.low <= true <= found.high)
    assert 0.925 < np.mean(hits) < 0.975
