"""Published numbers beside measured ones, with a verdict on each value and on the order.

A value is *inside* where it differs from the published one by at most the metric's relative tolerance. The
measured value of an ``ensemble_…`` metric is over all ok runs together; of any other metric it is the mean
over the ok runs.

An order, from best to worst, is judged between neighbours, on the seeds both finished: the geometric mean,
run by run, of worse over better (each run's own root mean square or mean), with the 95 % interval of
Student's t on the log of the ratios. A pair is *held* where the interval lies above 1, *violated* where it
lies below, a *tie* where it contains 1, and *too few runs* below 20. The whole order is

* violated, where a pair is, or where ``worst_factor`` is asked for and the last back end's value is less
  than so many times the value of the one before it;
* held, where every pair is;
* a tie (or too few runs) otherwise: the runs do not tell some neighbours apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.metrics.statistics import Interval, ratio_interval
from slamcmp.results.grid import at_point, grid_points, point_name
from slamcmp.results.judgements.ensemble import (
    COLUMNS,
    ENSEMBLE_METRICS,
    ensemble_value,
    run_values,
)
from slamcmp.results.judgements.published import Published, PublishedOrder
from slamcmp.results.partial import comparable
from slamcmp.results.store import Results
from slamcmp.types import IntArray

FEWEST_PAIRS = 20
"""Of fewer, a few runs that are far off in one direction decide."""


@dataclass(frozen=True)
class ValueVerdict:
    """One published value and what came out here."""

    label: str
    at: dict[str, Any]
    """Grid point; empty without a sweep."""
    metric: str
    published: float
    measured: float
    tolerance: float | None
    """Relative; None: shown, not judged."""
    runs: int
    """That ended well: no other is in ``measured``."""
    verdict: str
    """``inside``, ``outside``, ``not judged`` or ``not measured``."""

    @property
    def deviation(self) -> float:
        """Relative difference from the published value."""
        return (self.measured - self.published) / abs(self.published) if self.published else math.nan


@dataclass(frozen=True)
class PairVerdict:
    """Two neighbours of a published order."""

    better: str
    worse: str
    ratio: Interval
    """Worse over better, geometric mean over paired seeds, with its interval."""
    verdict: str
    """``held``, ``tie``, ``violated`` or ``too few runs``."""


@dataclass(frozen=True)
class OrderVerdict:
    """A published order and what came out here."""

    metric: str
    at: dict[str, Any]
    pairs: tuple[PairVerdict, ...]
    factor: float
    """Value of the last back end over the value of the one before it."""
    worst_factor: float | None
    """What ``factor`` has to reach."""
    verdict: str

    @property
    def text(self) -> str:
        """``batch = EKF < odometry``; ``=`` for a tie, ``>`` for a reversed pair, ``?`` for too few runs."""
        signs = {"held": "<", "tie": "=", "violated": ">", "too few runs": "?"}
        return " ".join(
            [self.pairs[0].better, *(f"{signs[each.verdict]} {each.worse}" for each in self.pairs)]
        )


@dataclass(frozen=True)
class PublishedVerdict:
    """Everything an experiment's ``published:`` section asks for."""

    source: str
    values: tuple[ValueVerdict, ...]
    orders: tuple[OrderVerdict, ...]

    def sentence(self) -> str:
        """How it ended, in one line."""
        judged = [each for each in self.values if each.verdict != "not judged"]
        inside = sum(each.verdict == "inside" for each in judged)
        parts = [f"{inside} of {len(judged)} judged values inside tolerance"] if judged else []
        for each in self.orders:
            place = ", ".join([each.metric, *filter(None, [point_name(each.at)])])
            parts.append(f"{place}: {each.text}: {each.verdict}")
        return "; ".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        values = [{**asdict(each), "deviation": each.deviation} for each in self.values]
        return {**asdict(self), "values": values, "sentence": self.sentence()}


def judge(results: Results) -> PublishedVerdict | None:
    """The verdict on the results of an experiment; None where it has no ``published:`` section."""
    section = results.manifest.get("config", {}).get("published")
    if not section:
        return None
    shown = comparable(results)
    return judge_published(Published.model_validate(section), shown.trials, shown.frames)


def judge_published(published: Published, trials: pd.DataFrame, frames: pd.DataFrame) -> PublishedVerdict:
    """The verdict on tables as the results folder holds them."""
    measured = _Measured(trials, frames)
    values = []
    for row in published.rows:
        for metric, value in row.values.items():
            found, tolerance = measured.value(metric, row.label, row.at), published.tolerance.get(metric)
            verdict = ValueVerdict(
                row.label, dict(row.at), metric, value, found, tolerance, measured.runs(row.label, row.at),
                _value_verdict(value, found, tolerance),
            )  # fmt: skip
            values.append(verdict)
    orders = [_judge_order(order, measured, point) for order in published.order for point in measured.points]
    return PublishedVerdict(published.source, tuple(values), tuple(orders))


def _value_verdict(published: float, measured: float, tolerance: float | None) -> str:
    if not math.isfinite(measured):
        return "not measured"
    if tolerance is None:
        return "not judged"
    return "inside" if abs(measured - published) <= tolerance * abs(published) else "outside"


def _judge_order(order: PublishedOrder, measured: _Measured, point: Mapping[str, Any]) -> OrderVerdict:
    pairs = []
    for better, worse in zip(order.labels, order.labels[1:], strict=False):
        both = pd.concat(
            [measured.by_run(order.metric, label, point) for label in (worse, better)], axis=1, join="inner"
        )
        ratio = ratio_interval(*both.to_numpy(float).T)
        if ratio.runs < FEWEST_PAIRS:
            ratio = replace(ratio, low=math.nan, high=math.nan)
        pairs.append(PairVerdict(better, worse, ratio, _pair_verdict(ratio)))
    before, last = (measured.value(order.metric, label, point) for label in order.labels[-2:])
    factor = last / before if before > 0 else math.nan
    verdict = _order_verdict([pair.verdict for pair in pairs], factor, order.worst_factor)
    return OrderVerdict(order.metric, dict(point), tuple(pairs), factor, order.worst_factor, verdict)


def _pair_verdict(ratio: Interval) -> str:
    if not math.isfinite(ratio.half_width):
        return "too few runs"
    if ratio.low > 1.0:
        return "held"
    return "violated" if ratio.high < 1.0 else "tie"


def _order_verdict(pairs: list[str], factor: float, worst_factor: float | None) -> str:
    if "violated" in pairs or (worst_factor is not None and factor < worst_factor):
        return "violated"
    if all(each == "held" for each in pairs):
        return "held"
    return "too few runs" if "too few runs" in pairs else "tie"


class _Measured:
    """The values that came out, by metric, back end and grid point."""

    def __init__(self, trials: pd.DataFrame, frames: pd.DataFrame) -> None:
        self._trials = trials[trials["status"] == "ok"]
        self._frames = frames
        self._rows: dict[str, IntArray] = {}
        self.points = grid_points(trials)

    def runs(self, label: str, point: Mapping[str, Any]) -> int:
        return len(self._ok(label, point))

    def value(self, metric: str, label: str, point: Mapping[str, Any]) -> float:
        ok = self._ok(label, point)
        if metric in ENSEMBLE_METRICS:
            return ensemble_value(metric, self._frames_of(ok, label))
        return float(ok[metric].mean()) if metric in ok.columns and len(ok) else math.nan

    def by_run(self, metric: str, label: str, point: Mapping[str, Any]) -> pd.Series:
        """One value a run, by seed."""
        ok = self._ok(label, point)
        if metric in ENSEMBLE_METRICS:
            values = run_values(metric, self._frames_of(ok, label)).reindex(ok["trial"])
        else:
            values = ok[metric] if metric in ok.columns else pd.Series(math.nan, index=ok.index)
        return pd.Series(values.to_numpy(float), index=ok["seed"])

    def _ok(self, label: str, point: Mapping[str, Any]) -> pd.DataFrame:
        return at_point(self._trials[self._trials["label"] == label], point)

    def _frames_of(self, ok: pd.DataFrame, label: str) -> pd.DataFrame:
        # Where a label's rows are is found once; its columns are copied when asked for, and not kept.
        if label not in self._rows:
            self._rows[label] = np.flatnonzero(self._frames["label"] == label)
        columns = [name for name in COLUMNS if name in self._frames]
        frames = self._frames[columns].iloc[self._rows[label]]
        kept = frames["trial"].isin(ok["trial"])
        return frames if kept.all() else frames[kept]
