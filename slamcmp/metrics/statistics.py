"""What N independent runs say: intervals, paired comparisons, tests and failure rates.

Only whole runs are samples: the frames of one run depend on each other, so nothing here takes frames. Values
that are not finite (failed runs, metrics a back end does not have) are left out, and every interval carries
the number of runs it rests on. Tests come from scipy.stats, which takes a second to import and is therefore
asked for where it is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtr, ndtr, ndtri

from slamcmp.errors import UsageError
from slamcmp.metrics.consistency import average_band
from slamcmp.types import FloatArray

Statistic = Callable[..., Any]
"""A numpy reduction such as ``np.mean``, called with ``axis=-1``."""

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
    outside = bdtr(np.arange(runs // 2), runs, 0.5)
    rank = int(np.searchsorted(outside, (1.0 - confidence) / 2.0, side="right"))
    if rank:
        low, high = float(ordered[rank - 1]), float(ordered[runs - rank])
    return Interval(float(np.median(ordered)), low, high, runs, confidence)


def bootstrap_interval(
    values: ArrayLike,
    statistic: Statistic = np.mean,
    *,
    confidence: float = 0.95,
    resamples: int = 4000,
    seed: int = 0,
) -> Interval:
    """A statistic's bias-corrected and accelerated bootstrap interval (Efron 1987, eq. 2.3 and 6.6).

    For smooth statistics: the acceleration comes from leaving out one run at a time, which says nothing
    about a median (use :func:`median_interval`). Below three runs there is no interval.
    """
    sample = finite(values)
    runs = sample.size
    if not runs:
        return Interval(math.nan, math.nan, math.nan, 0, confidence)
    estimate = float(statistic(sample, axis=-1))
    if runs < 3:
        return Interval(estimate, math.nan, math.nan, runs, confidence)
    rng = np.random.default_rng(seed)
    replicates = np.sort(statistic(sample[rng.integers(runs, size=(resamples, runs))], axis=-1))
    if replicates[0] == replicates[-1]:
        return Interval(estimate, estimate, estimate, runs, confidence)
    left_out = sample[np.array([np.delete(np.arange(runs), i) for i in range(runs)])]
    influence = np.mean(jackknifed := statistic(left_out, axis=-1)) - jackknifed
    spread = float((influence**2).sum())
    acceleration = float((influence**3).sum()) / (6.0 * spread**1.5) if spread > 0.0 else 0.0
    # Half of the replicates that equal the estimate count as below it; never 0 or 1, where ndtri is infinite.
    below = (np.searchsorted(replicates, estimate) + np.searchsorted(replicates, estimate, "right")) / 2
    bias = ndtri(np.clip(below / resamples, 1 / resamples, 1 - 1 / resamples))
    z = bias + ndtri(np.array([(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0]))
    shares = ndtr(bias + z / (1.0 - acceleration * z))
    low, high = np.quantile(replicates, shares)
    return Interval(estimate, float(low), float(high), runs, confidence)


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
