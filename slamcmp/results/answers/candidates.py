"""What the runs of one back end say about it as a choice: its errors, its honesty, its cost, its failures.

Honesty is judged by NEES where the truth is known: over the runs at the last frame, with the chi-square band
for so many runs (:func:`slamcmp.results.judgements.certainty.last_frame_nees`), and by the runs' means over
their frames, whose 95 % interval (Student's, from five runs on) must not lie above the dimension of the
pose. The second looks at all frames and so sees an overconfidence that the last frame has overcome; such
means are skewed to the right, where that interval's lower end is above the truth less often than it says, so
nobody is blamed for nothing.
Without truth there are innovations only, which a filter may have as large as it expects while its map is
metres off: they can show that it is overconfident, never that it is consistent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from slamcmp.metrics.statistics import Interval, finite
from slamcmp.results.grid import at_point, labels, milliseconds_per_frame, pose_dimension
from slamcmp.results.judgements.certainty import last_frame_nees
from slamcmp.results.numbers import number_text
from slamcmp.results.partial import comparable
from slamcmp.results.store import Results

FEWEST_RUNS = 5
"""Below so many nothing is called consistent, and no ratio has an interval."""
BLOCKS = 20
"""Into which one run's innovations are cut: neighbours of one block may depend on each other."""
FEWEST_IN_BLOCK = 5
"""Frames with innovations."""
KNOWS_THE_TRUTH = ("ekf_ideal",)
"""Back ends that no robot can run."""
Which = Literal["online", "final"]
Honesty = Literal["consistent", "overconfident", "underconfident", "not known"]


@dataclass(frozen=True)
class Consistency:
    """Whether the errors are as large as the back end says, and by what this is known."""

    verdict: Honesty
    evidence: str
    """``NEES``, ``innovations``, or empty where there is neither."""
    text: str
    """The numbers behind it: ``NEES 3.1 at the last frame (band 1.9 to 4.4, 12 runs), …``."""


@dataclass(frozen=True)
class Candidate:
    """One back end as a choice."""

    label: str
    which: Which
    """The trajectory that its error is of; of a filter without hindsight the online one, in both cases."""
    runs: int
    failures: tuple[str, ...]
    """Status and message of each run that did not end well."""
    errors: pd.Series = field(repr=False, compare=False)
    """By trial, of the runs that ended well."""
    consistency: Consistency
    cost_ms: float
    """Mean time of a frame, update and estimate, median over the runs; in hindsight with its share of the
    final solution."""
    p95_ms: float
    """The time that 95 of 100 frames keep to, update and estimate, median over the runs."""
    memory_mb: float
    """Largest growth of a run's memory."""
    costs: pd.Series = field(repr=False, compare=False)
    """Mean time of a frame by trial [ms]."""

    @property
    def failed_share(self) -> float:
        """Of all runs."""
        return len(self.failures) / self.runs if self.runs else 1.0

    @property
    def error(self) -> float:
        """Geometric mean over the runs that ended well; NaN without any."""
        values = finite(self.errors)
        positive = values[values > 0]
        return float(np.exp(np.log(positive).mean())) if positive.size else math.nan


def find_candidates(
    results: Results,
    *,
    point: Mapping[str, Any] | None = None,
    which: Which = "online",
    names: Sequence[str] | None = None,
    metric: str = "ate",
) -> list[Candidate]:
    """Every back end at one grid point that has an estimate of its own of that kind.

    Runs that are missing or were ended from outside count for nobody, and cost their trial for all. Left out
    are those that know the truth, those that are the reference itself, and online those whose
    estimates are another's (``batch`` solves once, after the last frame: its online column is its warm
    start's).

    Args:
        results: with or without frames; without, NEES is judged by the runs' means alone.
        point: swept values; default: all rows, as without a sweep.
        which: online, or final: with hindsight.
        names: labels to look at; default: all.
        metric: of the trajectory, to be small: ``ate``, ``heading_rmse_deg``.
    """
    results = comparable(results)
    trials = at_point(results.trials, point or {})
    left_out = _without_own(results, which)
    found = []
    for label in names if names is not None else labels(results):
        own = trials[trials["label"] == label]
        if own.empty or label in left_out or _is_reference(own, label, which):
            continue
        found.append(_candidate(results, own, label, which, metric))
    return found


def consistency_of(results: Results, own: pd.DataFrame, which: Which) -> Consistency:
    """Of these runs of one back end, all at one grid point."""
    ok = own[own["status"] == "ok"]
    column = f"{which}_pose_nees"
    if column in ok and ok[column].notna().any():
        return _by_nees(results, ok, which)
    return by_innovations(results, ok)


def student_interval(values: ArrayLike) -> Interval:
    """The mean with Student's 95 % interval, from five values on; of skewed ones its lower end is careful."""
    sample = finite(values)
    mean = float(sample.mean()) if sample.size else math.nan
    if sample.size < FEWEST_RUNS:
        return Interval(mean, math.nan, math.nan, sample.size)
    half = float(stdtrit(sample.size - 1.0, 0.975) * sample.std(ddof=1)) / math.sqrt(sample.size)
    return Interval(mean, mean - half, mean + half, sample.size)


def _candidate(results: Results, own: pd.DataFrame, label: str, which: Which, metric: str) -> Candidate:
    ok = own[own["status"] == "ok"]
    column = f"{which}_{metric}"
    if which == "final" and not (column in ok and ok[column].notna().any()):
        which, column = "online", f"online_{metric}"
    values = ok[column].to_numpy(float) if column in ok else np.full(len(ok), math.nan)
    parts = ["update_s", "estimate_s", *(["final_s"] if which == "final" else [])]
    known = [name for name in parts if name in ok]
    costs = milliseconds_per_frame(ok, *known).to_numpy(float) if known else np.full(len(ok), math.nan)
    failed = own[own["status"] != "ok"]
    memory = finite(_column(ok, "peak_memory_mb"))
    return Candidate(
        label,
        which,
        len(own),
        tuple(f"{row['status']}: {row.get('message') or 'no message'}" for row in failed.to_dict("records")),
        pd.Series(values, index=ok["trial"]),
        consistency_of(results, own, which),
        _median(costs),
        _median(_column(ok, "update_p95_ms") + _column(ok, "estimate_p95_ms")),
        float(memory.max()) if memory.size else math.nan,
        pd.Series(costs, index=ok["trial"]),
    )


def _by_nees(results: Results, ok: pd.DataFrame, which: Which) -> Consistency:
    dof = pose_dimension(results.frames)
    last = last_frame_nees(results, ok, which)
    means = student_interval(ok[f"{which}_pose_nees"])
    parts = []
    if last.runs:
        band = f"band {number_text(last.low)} to {number_text(last.high)}"
        parts.append(f"NEES {number_text(last.average)} at the last frame ({band}, {_runs(last.runs)})")
    bounds = f", 95 % {number_text(means.low)} to {number_text(means.high)}" if means.low == means.low else ""
    parts.append(f"{number_text(means.estimate)} over the frames (expected {dof}{bounds})")
    text = ", ".join(parts)
    if last.verdict == "overconfident" or means.low > dof:
        return Consistency("overconfident", "NEES", text)
    if max(last.runs, means.runs) < FEWEST_RUNS:
        return Consistency("not known", "NEES", text)
    if last.verdict == "underconfident" or means.high < dof:
        return Consistency("underconfident", "NEES", text)
    return Consistency("consistent", "NEES", text)


def by_innovations(results: Results, ok: pd.DataFrame) -> Consistency:
    """What the innovations of these finished runs say: overconfident, or nothing."""
    found, of = _innovations(results, ok)
    if not found.runs:
        return Consistency("not known", "", "neither truth nor innovations to judge it by")
    bounds = "" if found.low != found.low else f", 95 % {number_text(found.low)} to {number_text(found.high)}"
    text = f"squared innovations are {number_text(found.estimate)} times what it expects ({of}{bounds})"
    if found.low > 1.0:
        return Consistency("overconfident", "innovations", text)
    return Consistency("not known", "innovations", text)


def _innovations(results: Results, ok: pd.DataFrame) -> tuple[Interval, str]:
    """NIS over its degrees of freedom, with an interval over the runs, or over the blocks of a single one."""
    values = finite(_column(ok, "nis_per_dof"))
    if values.size != 1:
        return student_interval(values), _runs(values.size)
    frames = results.frames
    if {"nis", "nis_dof"} <= set(frames.columns):
        one = frames[(frames["label"] == ok["label"].iloc[0]) & frames["trial"].isin(ok["trial"])]
        one = one[np.isfinite(one["nis"].astype(float)) & (one["nis_dof"] > 0)].sort_values("k")
        if len(one) >= BLOCKS * FEWEST_IN_BLOCK:
            blocks = np.array_split(one[["nis", "nis_dof"]].to_numpy(float), BLOCKS)
            spread = student_interval([block[:, 0].sum() / block[:, 1].sum() for block in blocks])
            shift = float(values[0]) - spread.estimate
            return Interval(float(values[0]), spread.low + shift, spread.high + shift, 1), f"{BLOCKS} blocks"
    return Interval(float(values[0]), math.nan, math.nan, 1), "1 run"


def _without_own(results: Results, which: Which) -> set[str]:
    """Labels whose estimate of that kind is not their own, or not an estimate."""
    left_out = set()
    for each in results.manifest.get("config", {}).get("back_ends", []):
        label = str(each.get("label", each.get("name")))
        if each.get("name") in KNOWS_THE_TRUTH:
            left_out.add(label)
        if which == "online" and each.get("name") == "batch" and not each.get("every"):
            left_out.add(label)
    return left_out


def _is_reference(own: pd.DataFrame, label: str, which: Which) -> bool:
    return which == "final" and bool((own["reference"] == f"{label} (final)").all())


def _column(table: pd.DataFrame, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    if name not in table.columns:
        return np.full(len(table), math.nan)
    return table[name].to_numpy(dtype=np.float64)


def _median(values: ArrayLike) -> float:
    kept = finite(values)
    return float(np.median(kept)) if kept.size else math.nan


def _runs(count: int) -> str:
    return f"{count} run{'' if count == 1 else 's'}"
