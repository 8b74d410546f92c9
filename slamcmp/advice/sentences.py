"""Advice in words. Every comparison is a paired interval; what it does not tell apart is called so."""

from __future__ import annotations

import math
from collections.abc import Iterator

from slamcmp.advice.advice import Advice, Sentence, WhatIf, changes
from slamcmp.advice.answer import answer, reasons
from slamcmp.advice.evidence import (
    borrowed_truth,
    error_ratio,
    full_smoothing,
    gain_share,
    most_pairs,
    samples,
    time_ratio,
    told_apart,
)
from slamcmp.advice.ladder import BATCH, EKF, ODOMETRY, SMOOTHED
from slamcmp.advice.words import capital, listed, more_or_less, ratio_text, signed, the, time_words
from slamcmp.results.answers.candidates import FEWEST_RUNS
from slamcmp.results.answers.recommendation import NOBODY, RECOMMENDED
from slamcmp.results.grid import reference_name
from slamcmp.results.numbers import number_text


def write_sentences(advice: Advice) -> Iterator[Sentence]:
    """Everything that the advice says, the answer first."""
    for kind, texts in (
        ("answer", answer(advice)),
        ("odometry", _odometry(advice)),
        ("others", _others(advice)),
        ("hindsight", _hindsight(advice)),
        ("change", _change(advice)),
        ("failed", _failed(advice)),
        ("limits", _limits(advice)),
    ):
        for text in texts:
            yield Sentence(kind, capital(text))


def _odometry(advice: Advice) -> Iterator[str]:
    """Whether looking at landmarks gained anything at all."""
    found = advice.recommendation
    odometry = found.of(ODOMETRY)
    best = found.of(found.label or found.best or "")
    if odometry is None or best is None or best is odometry or most_pairs(found) < FEWEST_RUNS:
        return
    ratio = error_ratio(odometry.candidate, best.candidate)
    if not told_apart(ratio):
        yield f"Odometry alone is not told apart from {the(best.label)}: error over its {ratio_text(ratio)}."
    else:
        yield f"Odometry alone {more_or_less(ratio)} {the(best.label)}."


def _others(advice: Advice) -> Iterator[str]:
    """What each of the others buys, or lacks, against the one to take."""
    found = advice.recommendation
    taken = found.of(found.label or "")
    full = full_smoothing(found)
    if taken is None:
        return
    nothing, open_ones = [], []
    for each in found.choices:
        if each.distance == "out" or each.label in (taken.label, ODOMETRY) or each is full:
            continue
        ratio = error_ratio(each.candidate, taken.candidate)
        time = time_words(time_ratio(each.candidate, taken.candidate))
        if told_apart(ratio):
            yield f"{the(each.label)} {more_or_less(ratio)} {the(taken.label)}, {time}."
        elif ratio.low >= 1.0 - found.within:
            nothing.append(f"{the(each.label)} (error {signed(ratio)}, {time})")
        else:
            open_ones.append(f"{the(each.label)} (error {signed(ratio)}, {time})")
    if nothing:
        verb = "buys" if len(nothing) == 1 else "buy"
        yield f"{listed(nothing)} {verb} nothing over {the(taken.label)}."
    if open_ones:
        yield f"Not enough runs to say whether anything is bought by {listed(open_ones)}."


def _hindsight(advice: Advice) -> Iterator[str]:
    """What the trajectory gains if it is wanted afterwards."""
    found = advice.recommendation
    if found.which == "final" or most_pairs(found) < FEWEST_RUNS:
        return
    label = found.label if found.label in SMOOTHED else EKF
    share, gain = gain_share(advice.results, label, SMOOTHED[label], BATCH)
    if not share.runs:
        return
    if not borrowed_truth(advice) and not told_apart(gain):
        yield (
            f"If the trajectory is wanted afterwards: batch is not told apart from {the(label)} online "
            f"(error {signed(gain)})."
        )
        return
    how = "add `smooth: true`" if label != EKF else "take `ekf_world` with `smooth: true` (the EKF with RTS)"
    whole = "of the way to the batch solution" if borrowed_truth(advice) else "of what batch gains"
    gained = "" if borrowed_truth(advice) else f"; batch {more_or_less(gain)} what {the(label)} has online"
    if math.isfinite(share.half_width):
        value, low, high = (f"{100 * each:.0f}" for each in (share.estimate, share.low, share.high))
        yield f"If the trajectory is wanted afterwards, {how}: {value} % [{low}, {high}] {whole}{gained}."
    else:
        yield f"If the trajectory is wanted afterwards: not enough runs to say what share RTS gets{gained}."


def _change(advice: Advice) -> Iterator[str]:
    """What would change the answer, and what would not."""
    now = advice.recommendation
    same: list[WhatIf] = []
    for each in advice.what_ifs:
        different = changes(now, each.recommendation)
        if different is False:
            same.append(each)
        elif different:
            yield f"What would change this: {each.name}. Then it would be {_then(each)}."
        elif each.recommendation.verdict in (RECOMMENDED, NOBODY):
            yield f"With {each.name} it would be {_then(each)}."
        else:
            yield f"With {each.name}, not enough runs to say which it would be{_then(each)}."
    if same:
        names = listed([each.name for each in same])
        runs = f"{min(map(_runs, same))} runs{' each' if len(same) > 1 else ''}"
        yield f"{names} would not change this ({runs})."
    if advice.untried:
        why = "there are too few runs" if advice.runs < FEWEST_RUNS else "there was no time (--time-limit-s)"
        yield f"Not tried, for {why}: {', '.join(advice.untried)}."
    if not advice.varied:
        yield (
            "What would change this cannot be tried: the noise, the landmarks and the loops of a recording "
            "are what they were. More recordings of the same robot, each in a folder of its own or listed in "
            "the file's source, are paired samples."
        )


def _then(each: WhatIf) -> str:
    """Who, by which ratio, of how many runs."""
    then, runs = each.recommendation, f"{_runs(each)} runs"
    taken = then.of(then.label or "")
    if then.verdict == RECOMMENDED and taken is not None:
        behind = f"error over the best {ratio_text(taken.ratio)}, " if taken.label != then.best else ""
        return f"{the(taken.label)} ({behind}{runs})"
    if then.verdict == NOBODY:
        return f"nobody ({runs}): {reasons(then).removesuffix('.')}"
    shown = [choice for choice in then.choices if choice.label in then.undecided]
    ratios = "".join(
        f", {the(choice.label)} {ratio_text(choice.nearest)} of the error of {the(choice.against or '')}"
        for choice in shown
    )
    return f" ({runs}{ratios})"


def _runs(each: WhatIf) -> int:
    return int(each.results.trials["trial"].nunique())


def _failed(advice: Advice) -> Iterator[str]:
    for label, why in advice.dropped.items():
        yield f"{the(label)} {why}."
    trials = advice.results.trials
    for label in dict.fromkeys(trials["label"]):
        own = trials[trials["label"] == label]
        bad = own[own["status"] != "ok"]
        if len(bad) and str(label) not in advice.dropped:
            first = bad.iloc[0]
            how = first["status"].replace("_", " ")
            yield f"{the(str(label))}: {len(bad)} of {len(own)} runs {how} ({first['message']})."


def _limits(advice: Advice) -> Iterator[str]:
    """What all of this rests on."""
    now = advice.recommendation
    basis = f"{advice.runs} paired {samples(advice)}" if advice.runs > 1 else "one run"
    truth = "the batch solution plays truth" if borrowed_truth(advice) else "errors against the truth"
    if reference_name(advice.results) == "none":
        truth = "there is neither truth nor a batch solution to score against"
    budget = [f"{number_text(v)} {unit}" for v, unit in (
        (advice.asked.budget_ms, "ms a frame"), (advice.asked.memory_mb, "MB")
    ) if v is not None]  # fmt: skip
    fits = f", within {listed(budget)}" if budget else ""
    near = f"whose whole 95 % interval is within {100 * now.within:g} % of the best"
    yield f"Rule: the cheapest {near} and that is not overconfident{fits}. Basis: {basis}; {truth}."
    jobs = advice.jobs
    together = f"{jobs} jobs at a time" if jobs > 1 else "one job at a time"
    cpu = advice.results.manifest.get("cpu") or "this machine"
    yield f"Times are this machine's ({cpu}, {together}); another machine has others."
    yield from advice.notes
