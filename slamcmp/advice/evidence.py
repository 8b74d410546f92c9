"""Paired comparisons behind the sentences."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from slamcmp.advice.advice import Advice
from slamcmp.advice.ladder import BATCH, INCREMENTAL
from slamcmp.metrics.statistics import Interval, ratio_interval, share_interval
from slamcmp.results.answers.candidates import Candidate
from slamcmp.results.answers.recommendation import Choice, Recommendation
from slamcmp.results.grid import reference_name
from slamcmp.results.store import Results


def error_ratio(one: Candidate, other: Candidate) -> Interval:
    """Error of one over that of the other, on the trials that both finished."""
    pairs = pd.concat([one.errors, other.errors], axis=1, join="inner").dropna()
    return ratio_interval(pairs.iloc[:, 0], pairs.iloc[:, 1])


def time_ratio(one: Candidate, other: Candidate) -> Interval:
    """Time a frame of one over that of the other."""
    pairs = pd.concat([one.costs, other.costs], axis=1, join="inner").dropna()
    return ratio_interval(pairs.iloc[:, 0], pairs.iloc[:, 1])


def gain_share(results: Results, filter_label: str, smoothed: str, batch: str) -> tuple[Interval, Interval]:
    """Of what hindsight gains a filter: the share that its own smoother gets, and the gain with batch.

    Gains are relative to the filter's online error, run by run.

    Returns:
        Share (Fieller's interval), and batch's error over the filter's online one.
    """
    ok = results.trials[results.trials["status"] == "ok"]

    def errors(label: str, column: str) -> pd.Series:
        own = ok[ok["label"] == label]
        values = own[column].to_numpy(float) if column in own else np.full(len(own), math.nan)
        return pd.Series(values, index=own["trial"])

    columns = [errors(filter_label, "online_ate"), errors(smoothed, "final_ate"), errors(batch, "final_ate")]
    if reference_name(results) == f"{batch} (final)":
        # Its errors are distances from itself.
        columns[2] = pd.Series(0.0, index=columns[0].index)
    online, rts, full = pd.concat(columns, axis=1, join="inner").dropna().to_numpy(float).T
    return share_interval(1.0 - rts / online, 1.0 - full / online), ratio_interval(full, online)


def told_apart(ratio: Interval) -> bool:
    """Whether the runs tell the two apart."""
    return math.isfinite(ratio.half_width) and not ratio.low <= 1.0 <= ratio.high


def full_smoothing(found: Recommendation) -> Choice | None:
    """What a choice is held against: the smoother over everything, or the best without it."""
    full = found.of(BATCH if found.which == "final" else INCREMENTAL)
    if full is None or full.distance == "out":
        full = found.of(found.best or "")
    return full


def most_pairs(found: Recommendation) -> int:
    return max((each.ratio.runs for each in found.choices), default=0)


def borrowed_truth(advice: Advice) -> bool:
    return reference_name(advice.results) == f"{BATCH} (final)"


def samples(advice: Advice) -> str:
    """What the paired trials are: ``seeds`` or ``recordings``."""
    return "recordings" if "recording" in advice.results.trials else "seeds"
