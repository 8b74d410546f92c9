"""Add seeds in batches until the answer is as precise as ``until:`` asks for.

The search looks at the width of intervals only, never at which back end is ahead, and only after whole
batches. Even so it tends to end where an interval is narrow by luck, and such an interval covers less than it
says: 92 to 97 % for 95 % with batches of two to five seeds, 93 to 97 % with ten, 94 to 97 % with twenty and
more. :func:`search_coverage` simulates it for the rule at hand, and the manifest and the report tell it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from slamcmp.experiment.config.stop_rule import StopRule
from slamcmp.experiment.gathering.tables import trial_truth
from slamcmp.experiment.job.task import run_path, truth_path
from slamcmp.experiment.planning.trials import Trial
from slamcmp.metrics import score_run
from slamcmp.metrics.statistics import Interval, median_interval, median_rank, paired_interval
from slamcmp.results.runs.run_file import load_run, load_truth, relabelled
from slamcmp.types import FloatArray

MOST_SIMULATED = 400
"""Seeds; beyond, the coverage hardly changes."""


class MetricValues:
    """One metric of every finished run; each file is read once, however often one asks."""

    def __init__(self, folder: Path, metric: str, reference: str | None) -> None:
        self._folder, self._metric, self._reference = folder, metric, reference
        self._known: dict[tuple[str, ...], dict[str, float]] = {}

    def table(self, trials: Sequence[Trial]) -> pd.DataFrame:
        """One row a run: point (number of its grid point), label, seed, value (NaN where it is not ok)."""
        points: dict[str, int] = {}
        rows: list[tuple[int, str, int | None, float]] = []
        for trial in trials:
            point = points.setdefault(repr(dict(trial.swept)), len(points))
            key = tuple(job.key for job in trial.runs)
            if key not in self._known:
                try:
                    self._known[key] = self._read(trial)
                except MemoryError:
                    # The tables say it of each run; here they have no value.
                    self._known[key] = {job.back_end.label: math.nan for job in trial.runs}
            rows += [(point, label, trial.seed, value) for label, value in self._known[key].items()]
        return pd.DataFrame(rows, columns=["point", "label", "seed", "value"])

    def _read(self, trial: Trial) -> dict[str, float]:
        values = {job.back_end.label: math.nan for job in trial.runs}
        known = load_truth(truth_path(self._folder, trial.stream.key))
        stored = [
            relabelled(run, job.back_end.label)
            for job in trial.runs
            if (run := load_run(run_path(self._folder, job.key))) is not None
        ]
        if known is None:
            return values
        truth, _ = trial_truth(known, stored, self._reference)
        borrowed = truth is not None and known.truth is None
        for each in stored:
            if each.run.status == "ok":
                scores = score_run(each.run, truth, reference=True) if borrowed else each.scores
                values[each.run.back_end] = scores.get(self._metric, math.nan)
        return values


@dataclass(frozen=True)
class Precision:
    """How well one median is known, and how well it should be."""

    point: int
    """Number of the grid point."""
    label: str
    compared_with: str
    """The other back end of a difference; empty for a median of its own."""
    interval: Interval
    goal: float
    """The half width asked for."""

    @property
    def enough(self) -> bool:
        """Whether the interval is narrow enough."""
        return self.interval.half_width <= self.goal

    @property
    def name(self) -> str:
        """What the median is of."""
        return f"{self.label} against {self.compared_with}" if self.compared_with else self.label


def precisions(rule: StopRule, values: pd.DataFrame, labels: Sequence[str]) -> list[Precision]:
    """The precision of each median that the rule asks for.

    Args:
        rule: the rule.
        values: one row a run: point, label, seed, value (NaN where it failed or has no such metric).
        labels: of the back ends; the first with a value is what differences are taken to.

    Returns:
        One entry per grid point and back end; back ends without any value at a point are left out.
    """
    found: list[Precision] = []
    for point, rows in values.groupby("point", sort=True):
        table = rows.pivot(index="seed", columns="label", values="value")
        present = [label for label in labels if label in table and table[label].notna().any()]
        number = int(str(point))
        if rule.of == "each":
            for label in present:
                interval = median_interval(table[label], rule.confidence)
                goal = rule.half_width * (abs(interval.estimate) if rule.relative else 1.0)
                found.append(Precision(number, label, "", interval, goal))
            continue
        kind: Literal["difference", "ratio"] = "ratio" if rule.relative else "difference"
        for label in present[1:]:
            interval = paired_interval(table[label], table[present[0]], kind, rule.confidence)
            goal = rule.half_width * (interval.estimate if rule.relative else 1.0)
            found.append(Precision(number, label, present[0], interval, goal))
    return found


@cache
def search_coverage(batch: int, confidence: float, seeds: int) -> float | None:
    """How often the interval that ends a search holds the true median, over 2000 simulated searches.

    Lognormal errors (standard deviation of the logarithm 0.5), a look after each ``batch``, and a goal that
    typically ends the search at ``seeds``. None for so few that there is no interval.
    """
    usual = min(max(seeds, batch), MOST_SIMULATED)
    batch = min(batch, usual)
    rng = np.random.default_rng([batch, usual])
    sample = np.exp(0.5 * rng.normal(size=(2000, 2 * usual)))

    def bounds(rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        ordered, rank = np.sort(rows, axis=1), median_rank(rows.shape[1], confidence)
        if not rank:
            nothing = np.full(len(rows), math.nan)
            return nothing, nothing, nothing
        low, high = ordered[:, rank - 1], ordered[:, -rank]
        return low, high, (high - low) / (2.0 * np.median(ordered, axis=1))

    goal = float(np.median(bounds(sample[:, :usual])[2]))
    if math.isnan(goal):
        return None
    searching, covered = sample, 0
    for count in range(batch, 2 * usual + 1, batch):
        low, high, width = bounds(searching[:, :count])
        ended = (width <= goal) | (count + batch > 2 * usual)
        covered += int(np.count_nonzero(ended & (low <= 1.0) & (high >= 1.0)))
        searching = searching[~ended]
    return covered / len(sample)


def describe_stop(
    rule: StopRule, found: Sequence[Precision], seeds: int, *, interrupted: bool = False
) -> dict[str, Any]:
    """What a manifest says about the search: the rule, where it ended and why."""
    reached = bool(found) and all(each.enough for each in found)
    wide = sorted((each for each in found if not each.enough), key=lambda each: _excess(each), reverse=True)
    if interrupted:
        reason = "interrupted"
    elif reached:
        reason = f"every interval is narrow enough with {seeds} seeds"
    elif not found:
        reason = f"no finished run has a value of {rule.metric!r} to look at: more seeds would not help"
    else:
        worst = wide[0]
        width = worst.interval.half_width
        known = f"±{width:.3g}" if math.isfinite(width) else "no interval yet"
        reason = (
            f"{len(wide)} of {len(found)} intervals are too wide after {seeds} seeds; "
            f"the widest: {worst.name}, {known} where ±{worst.goal:.3g} is asked for"
        )
    return {
        **rule.model_dump(),
        "statistic": _statistic(rule),
        "reached": reached,
        # Of a search that ended by its rule; simulating it after each batch would cost more than the runs.
        "coverage": search_coverage(rule.batch, rule.confidence, seeds) if reached else None,
        "seeds": seeds,
        "reason": reason,
        "intervals": [
            {
                "point": each.point,
                "label": each.label,
                "compared_with": each.compared_with or None,
                "estimate": each.interval.estimate,
                "low": each.interval.low,
                "high": each.interval.high,
                "runs": each.interval.runs,
                "goal": each.goal,
            }
            for each in found
        ],
    }


def _excess(precision: Precision) -> float:
    return precision.interval.half_width / precision.goal if precision.goal > 0 else math.inf


def _statistic(rule: StopRule) -> str:
    if rule.of == "each":
        return "median"
    return "median paired ratio" if rule.relative else "median paired difference"
