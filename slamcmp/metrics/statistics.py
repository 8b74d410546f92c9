"""What N independent runs say: intervals, paired comparisons, tests and failure rates.

Only whole runs are samples: the frames of one run depend on each other, so nothing here takes frames. Values
that are not finite (failed runs, metrics a back end does not have) are left out, and every interval carries
the number of runs it rests on. Tests come from scipy.stats, which takes a second to import and is therefore
asked for where it is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtr, stdtr, stdtrit

from slamcmp.errors import UsageError
from slamcmp.metrics.consistency import average_band
from slamcmp.types import FloatArray

FEWEST_FOR_MEAN = 50
"""Runs, below which no interval of a mean of skewed errors is to be trusted."""
FEWEST_RATIOS = 5
"""Pairs, below which no interval of a ratio is told."""
EXACT_PAIRS = 60
"""Up to here the signed-rank test counts every sign pattern; beyond, the normal limit is good to 0.005."""
EXACT_TIED_PAIRS = 13
"""The same where two differences are alike: each of the 2^13 patterns is looked at."""


@dataclass(frozen=True)
class Interval:
    """A value with the bounds between which the truth is expected; NaN bounds: too few runs for any."""

    estimate: float
    low: float
    high: float
    runs: int
    confidence: float = 0.95

    @property
    def half_width(self) -> float:
        """Half the distance between the bounds; infinite where there are none."""
        width = (self.high - self.low) / 2.0
        return width if math.isfinite(width) else math.inf


@dataclass(frozen=True)
class AverageNees:
    """ANEES over independent runs at one frame, with the band a consistent back end stays in."""

    average: float
    low: float
    high: float
    runs: int

    @property
    def verdict(self) -> str:
        """``consistent``, ``overconfident`` (above the band) or ``underconfident``; empty without runs."""
        if not self.runs:
            return ""
        if self.average > self.high:
            return "overconfident"
        return "underconfident" if self.average < self.low else "consistent"


def median_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """The median with the distribution-free interval between two of the values (Conover 1999, sec. 3.2).

    The bounds are the l-th smallest and l-th largest value with the largest l for which fewer than l of N
    fair coins show heads with probability at most (1 - confidence) / 2. It covers at least ``confidence``
    for every continuous distribution; below six runs there is no 95 % interval.
    """
    ordered = np.sort(finite(values))
    runs = ordered.size
    if not runs:
        return Interval(math.nan, math.nan, math.nan, 0, confidence)
    low = high = math.nan
    rank = median_rank(runs, confidence)
    if rank:
        low, high = float(ordered[rank - 1]), float(ordered[runs - rank])
    return Interval(float(np.median(ordered)), low, high, runs, confidence)


def median_rank(runs: int, confidence: float = 0.95) -> int:
    """Which smallest and which largest of so many values bound their median; 0: they are too few."""
    outside = bdtr(np.arange(runs // 2), runs, 0.5)
    return int(np.searchsorted(outside, (1.0 - confidence) / 2.0, side="right"))


def mean_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """The mean with Student's interval corrected for skewness.

    By Hall's cubic transform of the studentised mean (Hall 1992, "On the removal of skewness by
    transformation"). Errors of estimators are skewed, and their mean lives on the few largest: bootstrap
    intervals hold the true mean far too seldom at the sizes of experiments (bias-corrected and accelerated:
    92 % of the samples of 12). Below :data:`FEWEST_FOR_MEAN` runs, from where on this one covers 93 to 97 %
    for errors whose standard deviation is up to their mean, there is none; a median has one sooner.
    """
    sample = finite(values)
    runs = sample.size
    mean = float(sample.mean()) if runs else math.nan
    if runs < FEWEST_FOR_MEAN:
        return Interval(mean, math.nan, math.nan, runs, confidence)
    deviation = float(sample.std(ddof=1))
    if deviation == 0.0:
        return Interval(mean, mean, mean, runs, confidence)
    skewness = float(((sample - mean) ** 3).mean()) / float(sample.std()) ** 3
    skewness *= math.sqrt(runs * (runs - 1.0)) / (runs - 2.0)

    def corrected(quantile: float) -> float:
        """The studentised mean whose transform g(t) = t + a t² + a² t³ / 3 + b / n is this quantile's."""
        t = quantile / math.sqrt(runs)
        a, b = skewness / 3.0, skewness / 6.0
        return t if abs(a) < 1e-9 else float((np.cbrt(1.0 + 3.0 * a * (t - b / runs)) - 1.0) / a)

    quantile = float(stdtrit(runs - 1.0, (1.0 + confidence) / 2.0))
    low, high = (mean - deviation * corrected(each) for each in (quantile, -quantile))
    return Interval(mean, low, high, runs, confidence)


def ratio_interval(values: ArrayLike, reference: ArrayLike, confidence: float = 0.95) -> Interval:
    """The geometric mean of ``values / reference`` over the pairs, by Student's t on the log of the ratios.

    Logarithms of error ratios are near normal, however skewed the errors: the interval covers 93 to 97 %
    from :data:`FEWEST_RATIOS` pairs on (below there is none), unless one run in ten is off by a factor of
    several in one direction; then from 30 pairs on. Pairs that are not both above 0 are left out.
    """
    logs = log_ratios(values, reference)
    if not logs.size:
        return Interval(math.nan, math.nan, math.nan, 0, confidence)
    mean = float(logs.mean())
    if logs.size < FEWEST_RATIOS:
        return Interval(math.exp(mean), math.nan, math.nan, logs.size, confidence)
    quantile = float(stdtrit(logs.size - 1.0, (1.0 + confidence) / 2.0))
    half = quantile * float(logs.std(ddof=1)) / math.sqrt(logs.size)
    return Interval(math.exp(mean), math.exp(mean - half), math.exp(mean + half), logs.size, confidence)


def share_interval(part: ArrayLike, whole: ArrayLike, confidence: float = 0.95) -> Interval:
    """Mean of ``part`` over mean of ``whole``, pair by pair, with Fieller's interval (Fieller 1954).

    Two gains on the same runs: how much of the one is the other? No interval where the runs do not tell the
    whole from nothing, for then its share can be anything, and below :data:`FEWEST_RATIOS` pairs.

    Raises:
        UsageError: the two do not have the same length.
    """
    parts, wholes = np.asarray(part, dtype=float), np.asarray(whole, dtype=float)
    if parts.shape != wholes.shape:
        raise UsageError(f"paired comparison: {parts.size} values and {wholes.size}; a pair is one seed")
    there = np.isfinite(parts) & np.isfinite(wholes)
    parts, wholes = parts[there], wholes[there]
    runs = parts.size
    if not runs or wholes.mean() == 0.0:
        return Interval(math.nan, math.nan, math.nan, runs, confidence)
    share = float(parts.mean() / wholes.mean())
    if runs < FEWEST_RATIOS:
        return Interval(share, math.nan, math.nan, runs, confidence)
    quantile = float(stdtrit(runs - 1.0, (1.0 + confidence) / 2.0))
    spread = quantile**2 / runs * np.cov(parts, wholes)
    # The shares s for which mean(part - s whole) does not differ from 0: a s² - 2 b s + c <= 0.
    a, b = wholes.mean() ** 2 - spread[1, 1], parts.mean() * wholes.mean() - spread[0, 1]
    c = parts.mean() ** 2 - spread[0, 0]
    if a <= 0.0:
        return Interval(share, math.nan, math.nan, runs, confidence)
    root = math.sqrt(max(b**2 - a * c, 0.0))
    return Interval(share, float((b - root) / a), float((b + root) / a), runs, confidence)


def ratio_test(values: ArrayLike, reference: ArrayLike) -> float:
    """Two-sided p value of Student's paired t test on the log of the ratios, which are 1 if both are alike.

    It is below 0.05 exactly where the 95 % interval of :func:`ratio_interval` leaves 1 out, and is the test
    that ``slamcmp seeds`` plans. NaN below :data:`FEWEST_RATIOS` pairs.
    """
    logs = log_ratios(values, reference)
    if logs.size < FEWEST_RATIOS:
        return math.nan
    mean, error = float(logs.mean()), float(logs.std(ddof=1)) / math.sqrt(logs.size)
    if error == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    return 2.0 * float(stdtr(logs.size - 1.0, -abs(mean) / error))


def log_ratios(values: ArrayLike, reference: ArrayLike) -> FloatArray:
    """``log(values / reference)`` of the pairs in which both are above 0 and finite.

    Raises:
        UsageError: the two do not have the same length.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return finite(np.log(paired_values(values, reference, "ratio")))


def paired_values(
    values: ArrayLike, reference: ArrayLike, kind: Literal["difference", "ratio"] = "difference"
) -> FloatArray:
    """``values - reference`` or ``values / reference`` of the pairs in which both are finite.

    Raises:
        UsageError: the two do not have the same length.
    """
    first, second = np.asarray(values, dtype=float), np.asarray(reference, dtype=float)
    if first.shape != second.shape:
        raise UsageError(f"paired comparison: {first.size} values and {second.size}; a pair is one seed")
    with np.errstate(divide="ignore", invalid="ignore"):
        return finite(first - second if kind == "difference" else first / second)


def paired_interval(
    values: ArrayLike,
    reference: ArrayLike,
    kind: Literal["difference", "ratio"] = "difference",
    confidence: float = 0.95,
) -> Interval:
    """The median difference or ratio over the seeds that both back ends finished, with its interval."""
    return median_interval(paired_values(values, reference, kind), confidence)


def sign_test(differences: ArrayLike) -> float:
    """Two-sided p value of as many positive differences under a fair coin; zeros are left out."""
    from scipy.stats import binomtest

    signs = np.sign(finite(differences))
    positive, pairs = int((signs > 0).sum()), int((signs != 0).sum())
    return float(binomtest(positive, pairs).pvalue) if pairs else math.nan


def signed_rank_test(differences: ArrayLike) -> float:
    """Two-sided p value of Wilcoxon's signed-rank test; zeros are left out, ties share their rank.

    Exact up to :data:`EXACT_PAIRS` pairs, with ties up to :data:`EXACT_TIED_PAIRS`; then the normal limit
    (Hollander and Wolfe 1999, sec. 3.1).
    """
    from scipy.stats import PermutationMethod, wilcoxon

    given = finite(differences)
    given = given[given != 0.0]
    if not given.size:
        return math.nan
    tied = np.unique(np.abs(given)).size < given.size
    method: Any = "exact"
    if given.size > (EXACT_TIED_PAIRS if tied else EXACT_PAIRS):
        method = "approx"
    elif tied:
        method = PermutationMethod(n_resamples=2**EXACT_TIED_PAIRS)
    return float(wilcoxon(given, method=method, correction=False).pvalue)


def wilson_interval(failures: int, runs: int, confidence: float = 0.95) -> Interval:
    """A rate of failures with Wilson's score interval (Wilson 1927); sensible at 0 and at all."""
    from scipy.stats import binomtest

    if not runs:
        return Interval(math.nan, math.nan, math.nan, 0, confidence)
    found = binomtest(failures, runs).proportion_ci(confidence, method="wilson")
    return Interval(failures / runs, float(found.low), float(found.high), runs, confidence)


def average_nees(values: ArrayLike, dof: int, confidence: float = 0.95) -> AverageNees:
    """Mean of one NEES a run, all at the same frame, with its band: N times it is chi-square of N dof.

    Bar-Shalom, Li and Kirubarajan 2001, eq. 5.4.2-7. Frames of one run must not be put in: the band would
    be far too narrow.
    """
    sample = finite(values)
    if not sample.size:
        return AverageNees(math.nan, math.nan, math.nan, 0)
    low, high = average_band(dof, sample.size, confidence)
    return AverageNees(float(sample.mean()), float(low), float(high), sample.size)


def finite(values: ArrayLike) -> FloatArray:
    """The finite ones of the values, as a flat array."""
    flat = np.asarray(values, dtype=np.float64).ravel()
    kept: FloatArray = flat[np.isfinite(flat)]
    return kept
