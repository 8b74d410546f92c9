"""Which back end to take: the cheapest whose error is within 5 % of the best, and that is consistent.

The rule, in order:

1. Out of the question is who failed in more than :data:`MOST_FAILED` of the runs, who needs more time or
   memory than there is, and who is overconfident: of what it says of its own error nothing may depend.
2. *The best* is the lowest geometric mean of the error among all that ran and can be afforded, overconfident
   ones included, over the trials that all of these finished. It is named; the rule does not need it.
3. *Within* is a back end whose ratio to each of the others, run by run, has its whole 95 % interval below
   1.05; *beyond* one whose interval to any of them lies wholly above; else the runs do not say. From five
   pairs on there is an interval (:func:`slamcmp.metrics.statistics.ratio_interval`). Held against all of
   them, not against the one that came out best, nobody is within by the luck of the draw; that each of the
   claims has to hold makes a correction for their number needless (an intersection-union test; compare
   "multiple comparisons with the best", Hsu 1984).
4. Recommended is the cheapest of those within that are left, if no cheaper one is undecided; where one is, or
   where there are too few runs, the verdict is ``not enough runs to say``. Who is merely not known to be
   consistent (no truth) is not excluded, and told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import pandas as pd

from slamcmp.metrics.statistics import Interval, ratio_interval
from slamcmp.results.answers.candidates import FEWEST_RUNS, Candidate, Which, find_candidates
from slamcmp.results.numbers import number_text
from slamcmp.results.store import Results

WITHIN = 0.05
"""Of the best error, as a share."""
MOST_FAILED = 0.02
"""Of the runs: one in fifty may fail; of fewer runs none."""
NOTHING = Interval(math.nan, math.nan, math.nan, 0)
RECOMMENDED: Final = "recommended"
TOO_FEW: Final = "not enough runs to say"
NOBODY: Final = "none"
Verdict = Literal["recommended", "not enough runs to say", "none"]
Distance = Literal["within", "beyond", "undecided", "out"]


@dataclass(frozen=True)
class Choice:
    """A candidate, held against the best."""

    candidate: Candidate
    ratio: Interval
    """Error over that of the best, geometric mean over the pairs; NaN where it is out before this."""
    distance: Distance
    """``out``: it is not compared."""
    nearest: Interval
    """The ratio that decided: of all ratios to others the one that reaches highest."""
    against: str | None
    """Label of that other."""
    reason: str = ""
    """Why it cannot be recommended; empty where it could be."""

    @property
    def label(self) -> str:
        """Of the back end."""
        return self.candidate.label


@dataclass(frozen=True)
class Recommendation:
    """What the rule says, and why."""

    verdict: Verdict
    label: str | None
    """Of the back end to take. With ``not enough runs to say`` the cheapest one that is known to be within,
    if there is any: a safe choice, perhaps not the cheapest."""
    best: str | None
    """The lowest error; who it is may not be known for sure."""
    which: Which
    within: float
    choices: tuple[Choice, ...]
    """All that were looked at, from the cheapest on."""
    undecided: tuple[str, ...] = ()
    """Consistent, cheaper than ``label``, and perhaps within as well: more runs would tell."""
    reason: str = ""
    """In one sentence, where nothing is recommended."""

    def of(self, label: str) -> Choice | None:
        """The choice of that label."""
        return next((each for each in self.choices if each.label == label), None)


def recommend(
    results: Results,
    *,
    point: Mapping[str, Any] | None = None,
    which: Which = "online",
    names: Sequence[str] | None = None,
    within: float = WITHIN,
    budget_ms: float | None = None,
    memory_mb: float | None = None,
    metric: str = "ate",
) -> Recommendation:
    """Apply the rule to one grid point of an experiment's results.

    Args:
        results: tables of an experiment; without frames NEES is judged by the runs' means alone.
        point: swept values; default: all rows, as without a sweep.
        which: ``online``: what is known at the time; ``final``: with hindsight, where a back end without a
            final trajectory stands with its online one.
        names: labels to choose from; default: all.
        within: share of the best error that an error may be above it.
        budget_ms: time a frame [ms] that 95 of 100 must keep to; with hindsight the mean, all included.
        memory_mb: that a run may add.
        metric: of the trajectory.
    """
    candidates = find_candidates(results, point=point, which=which, names=names, metric=metric)
    return choose(candidates, which=which, within=within, budget_ms=budget_ms, memory_mb=memory_mb)


def choose(
    candidates: Sequence[Candidate],
    *,
    which: Which = "online",
    within: float = WITHIN,
    budget_ms: float | None = None,
    memory_mb: float | None = None,
) -> Recommendation:
    """Apply the rule to candidates; arguments as in :func:`recommend`."""
    ordered = sorted(candidates, key=lambda each: (math.isnan(each.cost_ms), each.cost_ms))
    out = {each.label: _out(each, which, budget_ms, memory_mb) for each in ordered}
    running = [each for each in ordered if not out[each.label]]
    best = _best(running)
    choices = tuple(_choice(each, best, running, out[each.label], within) for each in ordered)
    if best is None:
        return Recommendation(NOBODY, None, None, which, within, choices, (), _why_nobody(choices))
    return _decide(choices, best, which, within)


def _decide(choices: tuple[Choice, ...], best: Candidate, which: Which, within: float) -> Recommendation:
    possible = [each for each in choices if not each.reason]
    runs = max((each.ratio.runs for each in choices), default=0)
    if runs < FEWEST_RUNS:
        why = f"{runs} run{'' if runs == 1 else 's'} that ended well, and {FEWEST_RUNS} are the fewest"
        return Recommendation(TOO_FEW, None, best.label, which, within, choices, (), why)
    taken = next((each for each in possible if each.distance == "within"), None)
    cheaper = possible[: possible.index(taken)] if taken is not None else possible
    undecided = tuple(each.label for each in cheaper if each.distance == "undecided")
    if taken is not None:
        verdict: Verdict = TOO_FEW if undecided else RECOMMENDED
        why = "" if not undecided else f"cheaper, and perhaps within as well: {', '.join(undecided)}"
        return Recommendation(verdict, taken.label, best.label, which, within, choices, undecided, why)
    if undecided:
        why = f"perhaps within: {', '.join(undecided)}"
        return Recommendation(TOO_FEW, None, best.label, which, within, choices, undecided, why)
    return Recommendation(NOBODY, None, best.label, which, within, choices, (), _why_nobody(choices))


def _out(each: Candidate, which: Which, budget_ms: float | None, memory_mb: float | None) -> str:
    """Why a candidate is not even compared."""
    if each.failed_share > MOST_FAILED:
        return f"{len(each.failures)} of {each.runs} runs failed ({each.failures[0]})"
    if math.isnan(each.error):
        return "its error is not known"
    time = each.p95_ms if which == "online" else each.cost_ms
    if budget_ms is not None and not time <= budget_ms:
        kind = "in 95 of 100 frames" if which == "online" else "a frame, all included"
        return f"over the budget of {number_text(budget_ms)} ms ({_or_unknown(time, 'ms')} {kind})"
    if memory_mb is not None and not each.memory_mb <= memory_mb:
        return f"over the memory of {number_text(memory_mb)} MB ({_or_unknown(each.memory_mb, 'MB')})"
    return ""


def _best(running: Sequence[Candidate]) -> Candidate | None:
    """The lowest geometric mean over the trials that all finished; the cheapest of equals."""
    if not running:
        return None
    common = pd.concat([each.errors for each in running], axis=1, join="inner").dropna()
    if common.empty:
        return min(running, key=lambda each: each.error)
    means = [
        float(ratio_interval(common.iloc[:, i], [1.0] * len(common)).estimate) for i in range(len(running))
    ]
    return running[min(range(len(running)), key=lambda i: (math.isnan(means[i]), means[i]))]


def _choice(
    each: Candidate, best: Candidate | None, running: Sequence[Candidate], out: str, within: float
) -> Choice:
    if out or best is None:
        return Choice(each, NOTHING, "out", NOTHING, None, out or "nobody is left to compare it with")
    ratios = {other.label: _ratio(each, other) for other in running if other is not each}
    distance: Distance = "undecided"
    if any(ratio.low > 1.0 + within for ratio in ratios.values()):
        distance = "beyond"
    elif all(ratio.high <= 1.0 + within for ratio in ratios.values()) and each.errors.size >= FEWEST_RUNS:
        distance = "within"
    # Where it is beyond, by whom; else who comes closest to that.
    key = (lambda name: ratios[name].low) if distance == "beyond" else (lambda name: ratios[name].high)
    against = max((name for name in ratios if ratios[name].half_width < math.inf), key=key, default=None)
    reason = ""
    if each.consistency.verdict == "overconfident":
        reason = f"overconfident: {each.consistency.text}"
    elif distance == "beyond":
        reason = f"more than {100 * within:g} % above the best"
    decided = NOTHING if against is None else ratios[against]
    return Choice(each, _ratio(each, best), distance, decided, against, reason)


def _ratio(one: Candidate, other: Candidate) -> Interval:
    pairs = pd.concat([one.errors, other.errors], axis=1, join="inner").dropna()
    return ratio_interval(pairs.iloc[:, 0], pairs.iloc[:, 1])


def _why_nobody(choices: Sequence[Choice]) -> str:
    if not choices:
        return "no back end has an estimate of its own of this kind"
    return "; ".join(f"{each.label}: {each.reason}" for each in choices)


def _or_unknown(value: float, unit: str) -> str:
    return f"{number_text(value)} {unit}" if value == value else "not measured"
