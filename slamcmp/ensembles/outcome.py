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
        used = self.runs_of_batch > 0
        sums, counts = self.curves[used][:, :, column], self.runs_of_batch[used]
        if not counts.size:
            return Estimated(math.nan, math.nan)
        total, runs = sums.sum(axis=0), counts.sum()
        value = scale * float(np.sqrt(total / runs).mean())
        m = counts.size
        if m < 3:
            return Estimated(value, math.nan)
        left = scale * np.sqrt((total - sums) / (runs - counts)[:, None]).mean(axis=1)
        return Estimated(value, math.sqrt((m - 1) / m * float(((left - left.mean()) ** 2).sum())))


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
        """Position RMSE of each filter but the first over the first one's, paired by seed.

        The interval is that of the delta method on the logarithm: with a and b the runs' mean squared errors,
        log sqrt(mean a / mean b) varies as the mean of (a / mean a - b / mean b) / 2 over the runs.
        """
        first = self.runs[0]
        found = {}
        for each in self.runs[1:]:
            both = (each.failed < 0) & (first.failed < 0)
            a, b = each.scores[both, at.SQUARED_POSITION], first.scores[both, at.SQUARED_POSITION]
            if len(a) < 2:
                found[each.label] = Ratio(math.nan, math.nan, math.nan)
                continue
            log = 0.5 * math.log(a.mean() / b.mean())
            spread = float((0.5 * (a / a.mean() - b / b.mean())).std(ddof=1))
            half = 1.96 * spread / math.sqrt(len(a))
            found[each.label] = Ratio(math.exp(log), math.exp(log - half), math.exp(log + half))
        return found


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
