"""What the experiment answers, in a sentence or two made from its paired numbers.

A back end is *better* or *worse* than the first one where the 95 % interval of the geometric mean ratio of
their errors, run by run on the same stream, leaves 1 out; else there is no difference, and the sentence says
at how many seeds. Below five pairs nothing is said to differ, and of a single seed that nothing can be said.
Runs that failed are in no ratio and are counted; so are those that are missing. Times are compared the same
way, and only where they were taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from slamcmp.metrics.statistics import median_interval, ratio_interval
from slamcmp.results.answers.against import SPELT, Against, comparisons, samples_text
from slamcmp.results.answers.phrases import (
    capital,
    change_text,
    listed,
    percent_text,
    share_text,
    tie_text,
    times_text,
    told_apart,
)
from slamcmp.results.answers.sweep_answer import over_the_sweep, sweep_lines
from slamcmp.results.grid import (
    at_point,
    grid_points,
    has_values,
    labels,
    milliseconds_per_frame,
    reference_name,
    swept_columns,
    value_text,
)
from slamcmp.results.judgements.summary import ENOUGH_SEEDS, errors_by_trial, warm_started
from slamcmp.results.numbers import number_text
from slamcmp.results.partial import comparable, missing_runs
from slamcmp.results.store import Results

NEAR_HALF = (0.45, 0.55)
"""A ratio that halves an error …"""
LISTED = 6
"""Back ends up to which the numbers of each are named where nothing can be compared."""
SURE_HALF = (0.4, 0.6)
"""… where its interval lies in here."""


@dataclass(frozen=True)
class Answer:
    """The answer in words."""

    sentences: tuple[str, ...]
    """One or two; the second says what failed or is missing."""
    lines: tuple[str, ...] = ()
    """Of a sweep: one for each back end, over the swept values."""

    @property
    def text(self) -> str:
        """The sentences as one text."""
        return " ".join(self.sentences)

    def __str__(self) -> str:
        return "\n".join([self.text, *self.lines])


def answer(results: Results) -> Answer:
    """The answer of an experiment's results.

    >>> import slamcmp
    >>> world = {"source": {"name": "circle", "landmarks": 10, "steps": 20}}
    >>> results = slamcmp.run({**world, "back_ends": ["ekf_slam", "isam2"]}, progress=False)
    >>> print(slamcmp.answer(results))  # doctest: +ELLIPSIS
    One seed: nothing can be said about which back end is better. On this one: online ATE ekf_slam ...
    """
    shown = _own_streams(comparable(results))
    ok = shown.trials[shown.trials["status"] == "ok"]
    more = tuple(_not_counted(results))
    if ok.empty:
        return Answer(("No run ended well: there is nothing to compare.", *more))
    kinds = [which for which in ("online", "final") if has_values(ok, [f"{which}_ate"])]
    if not kinds:
        first = "There are no errors to compare: the log has no truth, and no reference was named"
        time = _time_clause(shown, {})
        return Answer((f"{first}{f'; {time}' if time else ''}.", *more))
    most = max(len(own) for point in grid_points(ok) for _, own in at_point(ok, point).groupby("label"))
    if most > 1 and len(labels(shown)) == 1:
        return Answer((_alone(shown, ok, kinds[0]), *more))
    if most < ENOUGH_SEEDS:
        return Answer((_too_few(shown, ok, kinds, most), *more))
    if any(ok[path].map(value_text).nunique() > 1 for path in swept_columns(ok)):
        return Answer((over_the_sweep(shown, kinds), *more), tuple(sweep_lines(shown, kinds)))
    return Answer((_sentence(shown, kinds), *more))


def _own_streams(results: Results) -> Results:
    """Without trials in which back ends got different measurements: those are no pairs."""
    from dataclasses import replace

    known = results.trials[results.trials["digest"].astype(str) != ""]
    counts = known.groupby("trial")["digest"].nunique()
    mixed = set(counts.index[counts > 1])
    return replace(results, trials=results.trials[~results.trials["trial"].isin(mixed)])


def _too_few(results: Results, ok: pd.DataFrame, kinds: list[str], most: int) -> str:
    """``One seed: nothing can be said …``, and what these few runs gave."""
    first = f"{capital(samples_text(results, most))}: nothing can be said about which back end is better"
    if len(labels(results)) == 1:
        first = f"{capital(samples_text(results, 1))}: nothing can be said about any other"
    elif most > 1:
        first = (
            f"{samples_text(results, most)} are too few to tell back ends apart ({ENOUGH_SEEDS} are needed): "
            "nothing can be said about which is better"
        )
    if len(grid_points(ok)) > 1:
        return f"{first}, at any value that was swept."
    parts = []
    for which in kinds:
        own = ok[ok[f"{which}_ate"] > 0]
        if which == "online":
            own = own[~own["label"].isin(warm_started(results))]
        medians = own.groupby("label", sort=False)[f"{which}_ate"].median()
        if len(medians):
            parts.append(f"{'' if most == 1 else 'median '}{which} ATE {_listing(medians)} m")
    reference = reference_name(results)
    against = "" if reference in ("truth", "none") else f", measured against {reference}"
    where = f"{'On this one' if most == 1 else 'Here'}{against}"
    return f"{first}. {where}: {'; '.join(parts)}." if parts else f"{first}."


def _listing(medians: pd.Series[float]) -> str:
    """``EKF 0.31, iSAM2 0.28``; of many the first one, the best and the worst."""
    if len(medians) <= LISTED:
        return ", ".join(f"{label} {number_text(value)}" for label, value in medians.items())
    first, *_ = ordered = [(str(label), float(value)) for label, value in medians.items()]
    best, *_, worst = sorted(ordered, key=lambda each: each[1])
    ends = " to ".join(f"{number_text(value)} ({label})" for label, value in (best, worst))
    return f"{first[0]} {number_text(first[1])}, of all {len(medians)} from {ends}"


def _alone(results: Results, ok: pd.DataFrame, which: str) -> str:
    values = ok[f"{which}_ate"].dropna()
    known = median_interval(values)
    bounds = (
        f" [{number_text(known.low)}, {number_text(known.high)}]" if math.isfinite(known.half_width) else ""
    )
    where = " over all swept values" if len(grid_points(ok)) > 1 else ""
    return (
        f"{labels(results)[0]} ran alone, so nothing is compared: its median {which} ATE is "
        f"{number_text(known.estimate)} m{bounds} at {samples_text(results, known.runs)}{where}."
    )


def _sentence(results: Results, kinds: list[str]) -> str:
    clauses = []
    if "online" in kinds:
        clauses.append(_versus(results, comparisons(results, "online"), "online"))
    hindsight = _hindsight(results) if len(kinds) == 2 else ""
    if hindsight:
        clauses.append(hindsight)
    elif "final" in kinds:
        clauses.append(_versus(results, comparisons(results, "final"), "with hindsight"))
    clauses.append(_time_clause(results, {}))
    told = [clause for clause in clauses if clause]
    if not told:
        return "No two back ends have errors that can be compared: nothing can be said about which is better."
    return f"{capital('; '.join(told), labels(results))}."


def _versus(results: Results, found: list[Against], when: str) -> str:
    """``online, iSAM2 is 2 % [−1, 5] better than EKF: no difference at 20 seeds``."""
    if not found:
        return ""
    reference = found[0].other
    most = max(each.ratio.runs for each in found)
    few = [each for each in found if each.verdict == "too few"]
    if len(few) == len(found):
        if most == 0:
            names = listed([each.label for each in found])
            return f"{when}, {names} finished no seed that {reference} finished: nothing can be said"
        return (
            f"{when}, {samples_text(results, most)} are too few to tell "
            f"{listed([each.label for each in found])} from {reference} ({ENOUGH_SEEDS} pairs are needed)"
        )
    if len(found) == 1:
        (only,) = found
        samples = samples_text(results, only.ratio.runs)
        end = f": {tie_text([only.ratio], samples)}" if only.verdict == "tie" else f" at {samples}"
        return f"{when}, {only.label} is {change_text(only.ratio)} than {reference}{end}"
    parts = []
    for verdict in ("better", "worse"):
        own = sorted(
            (each for each in found if each.verdict == verdict),
            key=lambda each: each.ratio.estimate,
            reverse=verdict == "worse",
        )
        named = [f"{each.label} is {change_text(each.ratio)} than {reference}" for each in own[:SPELT]]
        if len(own) > SPELT:
            named.append(f"{len(own) - SPELT} more are {verdict}")
        parts += named
    ties = [each for each in found if each.verdict == "tie"]
    if ties:
        samples = samples_text(results, min(each.ratio.runs for each in ties))
        named = [f"{each.label} {percent_text(each.ratio)}" for each in ties[:SPELT]]
        more = [f"{len(ties) - SPELT} more"] if len(ties) > SPELT else []
        if len(ties) == 1:
            text = f"{ties[0].label} is {change_text(ties[0].ratio)} than {reference}"
        else:
            text = f"{listed([*(each.label for each in ties[:SPELT]), *more])} against {reference}"
            del named
        parts.append(f"{text}: {tie_text([each.ratio for each in ties], samples)}")
    if few:
        parts.append(f"{listed([each.label for each in few])}: too few common runs to say")
    return f"{when}, {', '.join(parts)}"


def _hindsight(results: Results) -> str:
    """``with hindsight the error halves (0.049 against 0.102 m), and RTS gets four fifths of that``."""
    trials = results.trials
    online = errors_by_trial(trials[~trials["label"].isin(warm_started(results))], "online_ate")
    final = errors_by_trial(trials, "final_ate")
    if online.empty or final.empty:
        return ""
    first = next(label for label in labels(results) if label in online)
    gains = {str(label): ratio_interval(final[label].reindex(online.index), online[first]) for label in final}
    enough = {label: gain for label, gain in gains.items() if gain.runs >= ENOUGH_SEEDS}
    if not enough:
        return ""
    best = min(enough, key=lambda label: enough[label].estimate)
    both = online[[first]].rename(columns={first: "online"}).join(final[[best]]).dropna()
    gain, samples = enough[best], samples_text(results, len(both))
    medians = " against ".join(number_text(float(both[name].median())) for name in (best, "online"))
    which = f"({medians} m, {best} final against {first} online)"
    if not told_apart(gain):
        return f"with hindsight there is {tie_text([gain], samples)} {which}"
    if gain.estimate > 1.0:
        return f"with hindsight the error grows: {percent_text(gain)} {which}"
    halved = NEAR_HALF[0] <= gain.estimate <= NEAR_HALF[1] and (
        SURE_HALF[0] <= gain.low and gain.high <= SURE_HALF[1]
    )
    fall = "halves" if halved else f"falls by {percent_text(gain)}"
    others = [label for label in labels(results) if label in enough and label != best]
    tail = _shares(online[first], final, best, others)
    return f"with hindsight the error {fall} {which}{tail}"


def _shares(online: pd.Series[float], final: pd.DataFrame, best: str, others: list[str]) -> str:
    """What the others get of the gain that hindsight brings the best one."""
    parts, alike = [], []
    for label in others:
        against = ratio_interval(final[label], final[best])
        if against.runs < ENOUGH_SEEDS:
            continue
        if not told_apart(against):
            alike.append(label)
            continue
        runs = pd.DataFrame({"online": online, "best": final[best], "own": final[label]}).dropna()
        gain = runs["online"] - runs["best"]
        share = median_interval((runs["online"] - runs["own"])[gain > 0] / gain[gain > 0])
        if share.estimate > 0.0:
            parts.append(f"{label} gets {share_text(share)} of that")
        else:
            parts.append(f"{label} gets nothing of that")
    if alike:
        does = "does" if len(alike) == 1 else "do"
        parts.insert(0, f"{listed(alike)} {does} as well as far as the runs can tell")
    return f", and {listed(parts)}" if parts else ""


def _time_clause(results: Results, point: Mapping[str, Any]) -> str:
    """``EKF is 7 × faster``: update and estimate of a frame, where times were taken."""
    trials = at_point(results.trials, point)
    trials = trials[(trials["status"] == "ok") & ~trials["label"].isin(warm_started(results))]
    if not has_values(trials, ["update_s", "estimate_s", "frames", "completion"]):
        return ""
    timed = trials.assign(ms=milliseconds_per_frame(trials, "update_s", "estimate_s"))
    times = timed.pivot(index="trial", columns="label", values="ms").dropna(how="all", axis="columns")
    if len(times.columns) < 2:
        return ""
    fastest = str(times.median().idxmin())
    others = {str(label): ratio_interval(times[label], times[fastest]) for label in times if label != fastest}
    slower = {label: ratio for label, ratio in others.items() if told_apart(ratio) and ratio.low > 1.0}
    if not slower:
        return ""
    jobs = results.manifest.get("jobs") or 1
    rough = f" (an order of magnitude: measured with {jobs} jobs side by side)" if jobs > 1 else ""
    if len(others) == 1:
        ((label, ratio),) = slower.items()
        return f"{fastest} is {times_text(ratio)} faster than {label}{rough}"
    ordered = sorted(slower.items(), key=lambda item: item[1].estimate)
    shown = ordered if len(ordered) <= SPELT else [ordered[0], ordered[-1]]
    parts = [f"{times_text(ratio)} faster than {label}" for label, ratio in shown]
    return f"{fastest} is {listed(parts)}{rough}"


def _not_counted(results: Results) -> Iterator[str]:
    """What failed, and what is missing: none of it is in a ratio."""
    trials = comparable(results).trials
    parts = []
    for label in labels(results):
        own = trials[trials["label"] == label]
        bad = int((own["status"] != "ok").sum())
        if bad:
            parts.append(f"{label} {bad} of {len(own)}")
    texts = [f"Failed, and in none of these numbers: {', '.join(parts)} runs."] if parts else []
    missing = missing_runs(results)
    if missing is not None:
        texts.append(f"{len(missing.runs)} of {missing.asked} runs are missing.")
    if texts:
        yield " ".join(texts)
