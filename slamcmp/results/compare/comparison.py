"""Two results folders side by side, run by run: of two commits, two configurations, two systems.

A run of one is paired with the run of the other that has the same grid point, seed (or recording) and back
end, and only where both ran on the same stream, told by its digest, and were scored against the same kind of
reference. What cannot be paired is refused with the reason. Ratios are other over base, geometric means over
the pairs with the 95 % interval of Student's t on their log; differences are medians with the
distribution-free interval. What an interval does not tell apart is a tie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from slamcmp.errors import UsageError
from slamcmp.metrics import MetricColumn, metric_columns
from slamcmp.metrics.statistics import Interval, paired_interval, ratio_interval
from slamcmp.registry import did_you_mean
from slamcmp.results.compare.conditions import Condition
from slamcmp.results.compare.differences import Differences, differences
from slamcmp.results.compare.paired_runs import Pairing, Refusal, folder_name, seeds_text
from slamcmp.results.grid import labels, point_name
from slamcmp.results.judgements.verdict import FEWEST_PAIRS
from slamcmp.results.numbers import interval_text, number_text
from slamcmp.results.store import Results
from slamcmp.types import FloatArray

DEFAULT_METRICS = ("online_ate", "final_ate", "landmark_rmse", "online_pose_nees", "update_median_ms")
"""What is compared unless something else is asked for, as far as both have it."""
Evidence = Literal["interval", "estimate"]


@dataclass(frozen=True)
class ComparedMetric:
    """One metric of one back end at one grid point, in both folders."""

    label: str
    at: dict[str, Any]
    metric: str
    unit: str
    pairs: int
    base: float
    """Median over the pairs."""
    other: float
    ratio: Interval
    """Other over base; NaN where no pair has two values above 0."""
    difference: Interval
    """Other less base, in the metric's unit."""
    verdict: str
    """One of better, worse, tie, identical, no pair, too few runs; without a direction higher or lower."""
    lost: tuple[str, ...] = ()
    """Seeds that have a value in the base only."""
    gained: tuple[str, ...] = ()
    """Seeds that the other finished and the base did not."""

    @property
    def place(self) -> str:
        """``EKF at source.range_sigma_m = 0.1``."""
        where = point_name(self.at)
        return f"{self.label} at {where}" if where else self.label


@dataclass(frozen=True)
class Comparison:
    """A folder held against the base."""

    base: str
    other: str
    differences: Differences
    rows: tuple[ComparedMetric, ...]
    refused: tuple[Refusal, ...]
    notes: tuple[str, ...] = ()

    @property
    def pairs(self) -> int:
        """Of runs, at the place that has most."""
        return max((row.pairs for row in self.rows), default=0)


@dataclass(frozen=True)
class Judgement:
    """What came of a condition."""

    condition: str
    fails: bool
    because: tuple[str, ...] = field(default=())


def compare_results(
    base: Results,
    other: Results,
    metrics: Sequence[str] | None = None,
    *,
    back_ends: Sequence[str] | None = None,
    names: Mapping[str, str] | None = None,
) -> Comparison:
    """Hold ``other`` against ``base``.

    Args:
        base: the folder that was there before.
        other: the one in question.
        metrics: columns of the trials table; default: :data:`DEFAULT_METRICS` that both have.
        back_ends: labels of the base to look at; default: all.
        names: labels of the other by those of the base that they are paired with, where they differ.

    Raises:
        UsageError: no such metric or label, or no run of the two can be paired: the message says why.
    """
    names = dict(names or {})
    _check_names(base, other, back_ends, names)
    chosen = _chosen_metrics(base, other, metrics)
    found = differences(base, other, names)
    pairing = Pairing(base, other, names, found)
    rows: list[ComparedMetric] = []
    for point, label in pairing.places(back_ends):
        pairs = pairing.pairs(point, label)
        rows += [
            row for name, about in chosen.items() if (row := _compared(pairs, label, point, name, about))
        ]
    if not pairing.paired:
        reasons = "; ".join(each.sentence() for each in pairing.refused[:3])
        both = f"{folder_name(base)} and {folder_name(other)}"
        raise UsageError(f"{both} cannot be compared: {reasons or 'no run in common'}")
    notes = _notes(base, other, rows)
    return Comparison(
        folder_name(base), folder_name(other), found, tuple(rows), tuple(pairing.refused), notes
    )


def judge_condition(
    condition: Condition, comparisons: Sequence[Comparison], evidence: Evidence = "interval"
) -> Judgement:
    """Whether a condition holds in any of the comparisons.

    With the evidence of the interval it holds where the whole 95 % interval is past the amount; where there
    are too few pairs for one, as with a recorded log, the estimate decides. A run that only the other lost
    is worse, and different, whatever the amount; what cannot be judged fails.

    Raises:
        UsageError: no back end has the metric in both folders.
    """
    about = metric_columns()[condition.metric]
    because: list[str] = []
    rows = [(each, row) for each in comparisons for row in each.rows if row.metric == condition.metric]
    if not rows:
        known = sorted({row.metric for each in comparisons for row in each.rows})
        raise UsageError(
            f"--fail-if {condition.text!r}: no back end has {condition.metric} in both; compared are "
            f"{', '.join(known)}"
        )
    for comparison, row in rows:
        place = f"{comparison.other}: {row.place}"
        if row.lost and condition.direction in ("worse", "differs"):
            because.append(f"{place}: {seeds_text(row.lost) or 'the run'} finished in {comparison.base} only")
        if not row.pairs:
            continue
        interval = row.ratio if condition.relative else row.difference
        if condition.relative and row.ratio.runs < row.pairs:
            because.append(f"{place}: a value is 0, so there is no ratio; give the amount in {about.unit}")
            continue
        bounds = interval.low, interval.high
        whole = evidence == "interval" and bool(np.isfinite(bounds).all())
        low, high = bounds if whole else (interval.estimate, interval.estimate)
        if condition.beyond(low, high, lower_is_better=about.lower_is_better):
            because.append(f"{place}: {_measured(row, relative=condition.relative)}")
    return Judgement(condition.text, bool(because), tuple(because))


def _measured(row: ComparedMetric, *, relative: bool) -> str:
    interval = row.ratio if relative else row.difference
    what = "ratio" if relative else "difference"
    unit = "" if relative or row.unit == "1" else f" {row.unit}"
    text = interval_text(interval)
    bounds = f" [{text}]" if text else " (too few pairs for an interval)"
    return f"{row.metric} {what} {number_text(interval.estimate)}{unit}{bounds}, {row.pairs} pairs"


def _check_names(
    base: Results, other: Results, back_ends: Sequence[str] | None, names: Mapping[str, str]
) -> None:
    for wanted, results in [
        *((each, base) for each in (*(back_ends or ()), *names)),
        *((each, other) for each in names.values()),
    ]:
        if wanted not in labels(results):
            raise UsageError(
                f"{folder_name(results)} has no back end {wanted!r}{did_you_mean(wanted, labels(results))}"
            )


def _chosen_metrics(base: Results, other: Results, metrics: Sequence[str] | None) -> dict[str, MetricColumn]:
    known = metric_columns()
    there = {
        name: about
        for name, about in known.items()
        if all(name in each.trials and each.trials[name].notna().any() for each in (base, other))
    }
    for name in metrics or ():
        if name not in known:
            raise UsageError(f"there is no metric {name!r}{did_you_mean(name, known)}")
        if name not in there:
            raise UsageError(f"{name} has no value in one of the two folders{did_you_mean(name, there)}")
    return {name: there[name] for name in metrics or DEFAULT_METRICS if name in there}


def _compared(
    pairs: Sequence[tuple[str, pd.Series, pd.Series]],
    label: str,
    point: dict[str, Any],
    name: str,
    about: MetricColumn,
) -> ComparedMetric | None:
    """None where the two do not both have the metric, as a filter and a smoother do not."""
    keys = [key for key, *_ in pairs]
    values = np.array([[_value(row, name) for row in both] for _, *both in pairs]).reshape(-1, 2)
    there = np.isfinite(values)
    whole = there.all(axis=1)
    failed = np.array([[row["status"] != "ok" for row in both] for _, *both in pairs], dtype=bool)
    failed = failed.reshape(-1, 2)
    lost = tuple(np.array(keys, dtype=object)[there[:, 0] & ~there[:, 1]])
    gained = tuple(np.array(keys, dtype=object)[there[:, 1] & failed[:, 0]])
    if not whole.any() and not (lost or gained):
        return None
    base, other = values[whole].T
    ratio, difference = ratio_interval(other, base), paired_interval(other, base)
    if whole.any() and (base == other).all():
        ratio = Interval(1.0, 1.0, 1.0, base.size)
        difference = Interval(0.0, 0.0, 0.0, base.size)
    before, now = (float(np.median(each)) if each.size else float("nan") for each in (base, other))
    verdict = _verdict(base, other, ratio, difference, about.lower_is_better)
    return ComparedMetric(
        label,
        point,
        name,
        about.unit,
        int(whole.sum()),
        before,
        now,
        ratio,
        difference,
        verdict,
        lost,
        gained,
    )


def _value(row: pd.Series, name: str) -> float:
    return float(row[name]) if row["status"] == "ok" and pd.notna(row.get(name)) else float("nan")


def _verdict(
    base: FloatArray, other: FloatArray, ratio: Interval, difference: Interval, lower_is_better: bool | None
) -> str:
    if not base.size:
        return "no pair"
    if (base == other).all():
        return "identical"
    # Where a value is 0 there is no ratio.
    interval, middle = (ratio, 1.0) if ratio.runs == base.size else (difference, 0.0)
    if not np.isfinite(interval.half_width):
        return "too few runs"
    if interval.low <= middle <= interval.high:
        return "tie"
    higher = interval.low > middle
    if lower_is_better is None:
        return "higher" if higher else "lower"
    return "worse" if higher == lower_is_better else "better"


def _notes(base: Results, other: Results, rows: Sequence[ComparedMetric]) -> tuple[str, ...]:
    """What a reader of the table has to know."""
    notes = []
    borrowed = sorted({str(each) for each in base.trials["reference"].dropna()} - {"truth", "none"})
    if borrowed:
        notes.append(f"no truth: errors are differences from {', '.join(borrowed)}, each folder's own")
    timed = [row for row in rows if row.unit in ("s", "ms")]
    machines = [each.manifest.get("cpu") for each in (base, other)]
    if timed and machines[0] != machines[1]:
        notes.append("times are of different processors")
    few = max((row.pairs for row in rows), default=0)
    if 0 < few < FEWEST_PAIRS:
        notes.append(f"{few} pairs: a few runs that are far off can decide; {FEWEST_PAIRS} or more are safer")
    return tuple(notes)
