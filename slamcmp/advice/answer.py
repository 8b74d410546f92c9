"""The first sentences: the back end to take, or why there is none to be named."""

from __future__ import annotations

import math
from collections.abc import Iterator

from slamcmp.advice.advice import Advice
from slamcmp.advice.evidence import (
    borrowed_truth,
    error_ratio,
    full_smoothing,
    most_pairs,
    samples,
    time_ratio,
    told_apart,
)
from slamcmp.advice.ladder import BATCH, EKF, INCREMENTAL, INVARIANT, ITERATED, ODOMETRY
from slamcmp.advice.words import listed, more_or_less, percent, ratio_text, signed, the, time_words
from slamcmp.metrics.statistics import Interval
from slamcmp.results.answers.candidates import FEWEST_RUNS, Candidate, by_innovations
from slamcmp.results.answers.recommendation import NOBODY, RECOMMENDED, Choice, Recommendation
from slamcmp.results.grid import reference_name
from slamcmp.results.numbers import number_text

MOST_RUNS = 5000
"""More than so many nobody makes: it is then said that the two are too much alike."""


def answer(advice: Advice) -> Iterator[str]:
    """Which one to take, how near it is to the best, and whether its covariance can be trusted."""
    found = advice.recommendation
    taken = None if found.label is None else found.of(found.label)
    if reference_name(advice.results) == "none":
        yield from _no_yardstick(advice)
    elif found.verdict == NOBODY:
        yield _nobody(advice)
    elif found.verdict == RECOMMENDED and taken is not None:
        yield _taken(advice, taken)
        yield from honesty(taken.candidate)
    elif most_pairs(found) < FEWEST_RUNS:
        yield from _too_few(advice)
    else:
        yield _undecided(found, samples(advice))
        if taken is not None:
            yield f"A safe choice: {_taken(advice, taken)}"
            yield from honesty(taken.candidate)
    for each in found.choices:
        about = each.candidate.consistency
        if about.verdict == "overconfident" and each.label == ODOMETRY and about.evidence == "NEES":
            yield f"Odometry errs more than it says; is the noise set for it too small? {about.text}."
        elif about.verdict == "overconfident":
            yield f"{the(each.label)} is overconfident, do not use its covariance: {about.text}."


def _taken(advice: Advice, taken: Choice) -> str:
    """The back end to take, beside full smoothing (or the best that there is)."""
    found = advice.recommendation
    when = "with hindsight" if found.which == "final" else "online"
    honest = {"consistent": ", and consistent", "underconfident": ", and more careful than it need be"}.get(
        taken.candidate.consistency.verdict, ""
    )
    compared = [each for each in found.choices if each.distance != "out" and each.label != ODOMETRY]
    if len(compared) > 2 and all(each.distance == "within" for each in compared) and taken.label != ODOMETRY:
        widest = max(each.nearest.high for each in compared)
        others = listed([the(each.label) for each in compared])
        honest_one = " of those not overconfident" if compared[0].reason else ""
        cost = number_text(taken.candidate.cost_ms)
        return (
            f"There is no difference that matters {when}: {others} are all within {100 * found.within:g} % "
            f"of each other, by {100 * (widest - 1):.1f} % at most. "
            f"Take the cheapest{honest_one}: {the(taken.label)}, {cost} ms a frame{honest}."
        )
    full = full_smoothing(found)
    if full is None or full.label == taken.label:
        return f"{_alone(found, taken, when)}{honest}."
    ratio = error_ratio(taken.candidate, full.candidate)
    name = f"full smoothing ({full.label})" if full.label in (INCREMENTAL, BATCH) else the(full.label)
    time = time_words(time_ratio(taken.candidate, full.candidate))
    if ratio.low > 1.0:
        near = f"is within {percent(ratio)} of {name} {when}"
    elif told_apart(ratio):
        near = f"{more_or_less(ratio)} {name} {when}"
    else:
        near = f"is as good {when} as {name} (error {signed(ratio)})"
    return f"On this robot {the(taken.label)} {near}, {time}{honest}."


def _alone(found: Recommendation, taken: Choice, when: str) -> str:
    """Where the one to take is full smoothing itself: what the cheaper ones lack."""
    name = f"full smoothing ({taken.label})" if taken.label in (INCREMENTAL, BATCH) else the(taken.label)
    lacking = []
    for each in found.choices[: found.choices.index(taken)]:
        if each.distance == "out" or each.label == ODOMETRY:
            continue
        ratio = error_ratio(each.candidate, taken.candidate)
        if told_apart(ratio) and ratio.low > 1.0:
            lacking.append(f"{the(each.label)} {more_or_less(ratio)} it")
        elif each.reason:
            lacking.append(f"{the(each.label)} is overconfident")
    so = f" ({'; '.join(lacking)})" if lacking else ""
    return (
        f"On this robot {name} is worth its {number_text(taken.candidate.cost_ms)} ms a frame {when}: nobody "
        f"cheaper is within {100 * found.within:g} % of the best and honest{so}"
    )


def honesty(candidate: Candidate) -> Iterator[str]:
    about = candidate.consistency
    if about.evidence == "innovations":
        yield (
            f"Whether {the(candidate.label)} is consistent nobody can tell without truth. Its {about.text}; "
            "healthy innovations do not show that its map is right."
        )
    elif about.text and about.evidence:
        word = {"underconfident": "larger than its errors", "not known": "not judged"}.get(about.verdict)
        judged = f"The covariance of {the(candidate.label)} "
        yield f"{judged}{f'is {word}' if word else 'fits its errors'}: {about.text}."


def _nobody(advice: Advice) -> str:
    found = advice.recommendation
    if found.best is None:
        return f"No back end can be recommended. {reasons(found)}"
    near = f"within {100 * found.within:g} % of the best ({the(found.best)})"
    return f"No back end is both {near} and consistent. {reasons(found)}"


def reasons(found: Recommendation) -> str:
    told = [f"{the(each.label)}: {each.reason}" for each in found.choices if each.reason]
    return ("; ".join(told) or found.reason) + "."


def _undecided(found: Recommendation, kind: str) -> str:
    names = listed([the(label) for label in found.undecided])
    shown = [each for each in found.choices if each.label in found.undecided]
    first = shown[0]
    of_them = ", the cheapest of them," if len(shown) > 1 else ""
    ratios = (
        f"{the(first.label)}{of_them} has {ratio_text(first.nearest)} of the error of "
        f"{the(first.against or '')}"
    )
    cheaper = ", which cost less, are" if len(shown) > 1 else ", which costs less, is"
    if found.label is None:
        cheaper = " are" if len(shown) > 1 else " is"
    more = [runs for each in shown if (runs := _runs_needed(each.nearest, found.within))]
    need = ""
    if more:
        count = max(more)
        option = f" (--seeds {count})" if kind == "seeds" else ""
        need = (
            f" About {count} {kind} would tell{option}."
            if count <= MOST_RUNS
            else " They are so near to the limit that no number of runs would tell."
        )
    near = f"within {100 * found.within:g} % of the best"
    return f"Not enough runs to say whether {names}{cheaper} {near}: {ratios}.{need}"


def _too_few(advice: Advice) -> Iterator[str]:
    """What one or a few runs show, without any claim for the next."""
    found, pairs = advice.recommendation, most_pairs(advice.recommendation)
    runs = "1 run" if pairs == 1 else f"{pairs} runs"
    yield (
        f"Not enough runs to say which back end to take: {runs} that ended well, and an interval needs "
        f"{FEWEST_RUNS}. Errors within one run depend on each other, each is carried on into the next: "
        "cutting it into pieces would give no honest interval."
    )
    what = "distance from the batch solution" if borrowed_truth(advice) else "error"
    shown = [
        f"{each.label} {number_text(own.error)} m ({number_text(own.cost_ms)} ms a frame)"
        for each in found.choices
        for own in [each.candidate]
        if own.error == own.error
    ]
    if shown:
        yield f"What was seen, with no claim for another run ({what}): {'; '.join(shown)}."
    yield from _innovations(advice)


def _no_yardstick(advice: Advice) -> Iterator[str]:
    """Where nobody's error is known."""
    why = advice.dropped.get(BATCH) or "did not end well"
    yield (
        f"There is no truth, and no batch solution in its place ({BATCH} {why}): nothing to hold the others "
        "against. More time may help (--time-limit-s), or a truth, if only of a part of the way."
    )
    yield from _innovations(advice)


def _innovations(advice: Advice) -> Iterator[str]:
    """What one filter's innovations say."""
    trials = advice.results.trials
    for label in (EKF, INVARIANT, ITERATED):
        about = by_innovations(
            advice.results, trials[(trials["label"] == label) & (trials["status"] == "ok")]
        )
        if about.evidence:
            judged = (
                "more than the noise that was set explains"
                if about.verdict == "overconfident"
                else "which accuses nobody, but does not show that pose and map are right"
            )
            yield f"{the(label)}'s {about.text}: {judged}."
            # Of all filters nearly the same.
            return


def _runs_needed(ratio: Interval, within: float) -> int:
    """About how many runs would bring the interval to one side of the limit; 0: not known."""
    if not (math.isfinite(ratio.half_width) and ratio.low > 0):
        return 0
    half = (math.log(ratio.high) - math.log(ratio.low)) / 2
    gap = abs(math.log1p(within) - math.log(ratio.estimate))
    return math.ceil(ratio.runs * (half / gap) ** 2) + 1 if gap > 0 else 10 * MOST_RUNS
