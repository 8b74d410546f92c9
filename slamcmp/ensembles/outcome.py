"""What the runs of an ensemble say together: numbers with their standard errors, and paired ratios."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from slamcmp.ensembles.kernels import settings as at
from slamcmp.ensembles.problem import EnsembleProblem
from slamcmp.types import FloatArray, IntArray

BLOCK = 50
"""Runs that a core does in one call: about half a second."""
BATCHES = 50
"""Groups of blocks; what is no mean over runs gets its standard error by leaving out one at a time."""


@dataclass(frozen=True)
class Estimated:
    """A number of the ensemble with its standard error."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class Ratio:
    """A filter's error over the first one's, on the same seeds, with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """``better``, ``worse``, or ``a tie`` where the interval holds 1."""
        if not self.low <= self.high:
            return "not known"
        return "better" if self.high < 1 else "worse" if self.low > 1 else "a tie"


@dataclass(frozen=True)
class FilterRuns:
    """All runs of one filter."""

    label: str
    scores: FloatArray
    """(runs, 5), see kernels/settings.py; NaN where the filter failed."""
    curves: FloatArray
    """Sums over the runs of each batch, (BATCHES, K, 2): squared position [m^2] and heading error [rad^2]."""
    runs_of_batch: IntArray
    """(BATCHES,): runs in those sums."""
    failed: IntArray
    """The frame of each run's failure, (runs,); -1: none."""

    @property
    def failures(self) -> int:
        """Runs in which the filter gave up; they are in no other number."""
        return int((self.failed >= 0).sum())

    def joined(self, more: FilterRuns) -> FilterRuns:
        """These and the runs that follow them."""
        return FilterRuns(
            self.label,
            np.concatenate([self.scores, more.scores]),
            self.curves + more.curves,
            self.runs_of_batch + more.runs_of_batch,
            np.concatenate([self.failed, more.failed]),
        )

    def metrics(self) -> dict[str, Estimated]:
        """By the names of results/judgements/ensemble.py: over runs and frames, with standard errors."""
        scores = self.scores[self.failed < 0]
        return {
            "ensemble_heading_rmse_deg": _rmse(scores[:, at.SQUARED_HEADING], math.degrees(1.0)),
            "ensemble_position_rmse": _rmse(scores[:, at.SQUARED_POSITION], 1.0),
            "ensemble_nees_heading": _mean(scores[:, at.NEES_HEADING]),
            "ensemble_nees_position": _mean(scores[:, at.NEES_POSITION]),
            "ensemble_nees_pose": _mean(scores[:, at.NEES_POSE]),
            "ensemble_mean_heading_rmse_deg": self._mean_rmse(1, math.degrees(1.0)),
            "ensemble_mean_position_rmse": self._mean_rmse(0, 1.0),
        }

    def rmse_over_time(self) -> FloatArray:
        """RMSE over the runs at each frame, (K, 2): position [m], heading [rad]."""
        rmse: FloatArray = np.sqrt(self.curves.sum(axis=0) / self.runs_of_batch.sum())
        return rmse

    def _mean_rmse(self, column: int, scale: float) -> Estimated:
        """The mean over frames of the RMSE over runs; its error by the jackknife over batches."""
        whole, left = self.means_of_rmse(column)
        return Estimated(scale * whole, scale * _jackknife(left))

    def means_of_rmse(self, column: int) -> tuple[float, FloatArray]:
        """The mean over frames of the RMSE over runs, and the same without one batch at a time, (BATCHES,).

        NaN of a batch that has no runs.
        """
        sums, counts = self.curves[:, :, column], self.runs_of_batch
        if not counts.sum():
            return math.nan, np.full(len(counts), math.nan)
        total, runs = sums.sum(axis=0), counts.sum()
        used = (counts > 0) & (counts < runs)
        left = np.full(len(counts), math.nan)
        left[used] = np.sqrt((total - sums[used]) / (runs - counts[used])[:, None]).mean(axis=1)
        return float(np.sqrt(total / runs).mean()), left


@dataclass(frozen=True)
class Ensemble:
    """What an ensemble found."""

    problem: EnsembleProblem
    runs: tuple[FilterRuns, ...] = ()
    """One for each of the problem's filters, or none yet."""
    deviations: Mapping[str, float] = field(default_factory=dict)
    """By label: the largest difference to the ordinary back end in the runs that were compared."""

    @property
    def seeds(self) -> int:
        """Runs of each filter: seeds 0, 1, …"""
        return len(self.runs[0].scores) if self.runs else 0

    def with_more(self, more: tuple[FilterRuns, ...]) -> Ensemble:
        """With the runs that follow."""
        if not self.runs:
            return replace(self, runs=more)
        return replace(self, runs=tuple(a.joined(b) for a, b in zip(self.runs, more, strict=True)))

    def ratios(self) -> dict[str, Ratio]:
        """Position RMSE of each filter but the first over the first one's, paired by seed."""
        first, *others = (each.label for each in self.runs)
        return {each: self.ratio("ensemble_position_rmse", each, first) for each in others}

    def ratio(self, metric: str, label: str, over: str) -> Ratio:
        """A metric of one filter over that of another on the same seeds, with its 95 % interval.

        Of means over runs by the delta method on the logarithm: with a and b the runs' values,
        log(mean a / mean b) varies as the mean of a / mean a - b / mean b; the root of a mean by half of it.
        Of means over frames by the jackknife over batches.

        Raises:
            KeyError: no such metric or label.
        """
        by_label = {each.label: each for each in self.runs}
        one, other = by_label[label], by_label[over]
        if metric in _OVER_FRAMES:
            (a, left_a), (b, left_b) = (each.means_of_rmse(_OVER_FRAMES[metric]) for each in (one, other))
            return _ratio(math.log(a / b), _jackknife(np.log(left_a / left_b)))
        column, power = _OVER_RUNS[metric]
        both = (one.failed < 0) & (other.failed < 0)
        a_runs, b_runs = one.scores[both, column], other.scores[both, column]
        if len(a_runs) < 2:
            return _ratio(math.nan, math.nan)
        varied = power * (a_runs / a_runs.mean() - b_runs / b_runs.mean())
        error = float(varied.std(ddof=1)) / math.sqrt(len(varied))
        return _ratio(power * math.log(a_runs.mean() / b_runs.mean()), error)


_OVER_RUNS = {
    "ensemble_heading_rmse_deg": (at.SQUARED_HEADING, 0.5),
    "ensemble_position_rmse": (at.SQUARED_POSITION, 0.5),
    "ensemble_nees_heading": (at.NEES_HEADING, 1.0),
    "ensemble_nees_position": (at.NEES_POSITION, 1.0),
    "ensemble_nees_pose": (at.NEES_POSE, 1.0),
}
"""Column of the scores, and the power of their mean."""
_OVER_FRAMES = {"ensemble_mean_position_rmse": 0, "ensemble_mean_heading_rmse_deg": 1}
"""Column of the curves."""
METRICS = (*_OVER_RUNS, *_OVER_FRAMES)


def _ratio(log: float, error: float) -> Ratio:
    return Ratio(math.exp(log), math.exp(log - 1.96 * error), math.exp(log + 1.96 * error))


def _jackknife(left_out: FloatArray) -> float:
    """The standard error, from values that each leave out one batch; NaN from fewer than three."""
    left = left_out[np.isfinite(left_out)]
    m = len(left)
    return math.sqrt((m - 1) / m * float(((left - left.mean()) ** 2).sum())) if m > 2 else math.nan


def _mean(values: FloatArray) -> Estimated:
    if not len(values):
        return Estimated(math.nan, math.nan)
    error = float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Estimated(float(values.mean()), error)


def _rmse(squares: FloatArray, scale: float) -> Estimated:
    """The root of a mean, and the mean's standard error through it."""
    mean = _mean(squares)
    root = math.sqrt(mean.value) if mean.value >= 0 else math.nan
    return Estimated(scale * root, scale * mean.standard_error / (2 * root) if root > 0 else math.nan)
