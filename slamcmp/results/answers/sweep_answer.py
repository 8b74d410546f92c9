"""The answer of an experiment that swept something: how often each back end differs, and where."""

from __future__ import annotations

import math
from collections.abc import Iterator

from slamcmp.results.answers.against import SPELT, Against, by_label, comparisons, samples_text
from slamcmp.results.answers.phrases import capital, change_text, listed, tie_text
from slamcmp.results.grid import labels, swept_columns, value_text
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words, setting_in_words

SPELT_POINTS = 6
"""Swept values up to which each is named."""


def over_the_sweep(results: Results, kinds: list[str]) -> str:
    """How often each back end differs from the first one, over all that was swept."""
    which = kinds[0]
    found = comparisons(results, which)
    if not found and len(kinds) == 2:
        which, found = "final", comparisons(results, "final")
    if not found:
        return "No two back ends have errors that can be compared: nothing can be said about which is better."
    when = "online" if which == "online" else "with hindsight"
    groups = [own for _, own in by_label(found)]
    alike = [own for own in groups if all(each.verdict == "tie" for each in own)]
    parts = [_counted(own) for own in groups if own not in alike]
    parts += _ties(alike)
    text = f"{when}, over {_swept_text(results)}: {', '.join(parts)}"
    return f"{capital(text, labels(results))}."


def sweep_lines(results: Results, kinds: list[str]) -> Iterator[str]:
    """A line per back end over the swept values, with what differs only."""
    tables = {which: dict(by_label(comparisons(results, which))) for which in kinds}
    for label in labels(results):
        parts = []
        for which, of_label in tables.items():
            if label in of_label:
                own = of_label[label]
                parts.append(f"{which}, against {own[0].other}: {_over_values(results, own)}")
        if parts:
            yield f"{label}: {'; '.join(parts)}."


def _ties(alike: list[list[Against]]) -> list[str]:
    """``RTS and iSAM2 show no difference from EKF at any of 9 values``, for those with as many values."""
    parts = []
    for count in dict.fromkeys(len(own) for own in alike):
        own = [each for each in alike if len(each) == count]
        names, verb = listed([each[0].label for each in own]), "shows" if len(own) == 1 else "show"
        where = f"at any of {count} values" if count > 1 else "at the one value"
        parts.append(f"{names} {verb} no difference from {own[0][0].other} {where}")
    return parts


def _counted(own: list[Against]) -> str:
    """``iSAM2 is better than EKF at 2 of 5 values, no difference at 3``."""
    label, other = own[0].label, own[0].other
    counts = {verdict: sum(each.verdict == verdict for each in own) for verdict in ("better", "worse")}
    ties = [each for each in own if each.verdict == "tie"]
    few = [each for each in own if each.verdict == "too few"]
    if len(few) == len(own):
        return f"{label} and {other} have too few common runs to say"
    parts = [
        f"{verdict} than {other} at {count} of {len(own)} values"
        for verdict, count in counts.items()
        if count
    ]
    rest = []
    if ties:
        rest.append(f"no difference {f'from {other} ' if not parts else ''}told at {len(ties)}")
    if few:
        rest.append(f"too few runs at {len(few)}")
    head = f"{label} is {listed(parts)}" if parts else label
    if parts and rest:
        return f"{head} ({'; '.join(rest)})"
    return f"{head}: {'; '.join(rest)}" if rest else head


def _over_values(results: Results, own: list[Against]) -> str:
    alike = len({each.verdict for each in own}) == 1
    if len(own) == 1 or (alike and own[0].verdict in ("tie", "too few")):
        (verdict,) = {each.verdict for each in own}
        if verdict == "too few":
            return "too few common runs to say"
        if verdict == "tie":
            samples = samples_text(results, min(each.ratio.runs for each in own))
            end = f" at any of {len(own)} values" if len(own) > 1 else ""
            return f"{tie_text([each.ratio for each in own], samples)}{end}"
        return change_text(own[0].ratio)
    apart = [each for each in own if each.verdict in ("better", "worse")]
    if len(apart) > SPELT_POINTS:
        strongest = sorted(apart, key=lambda each: -abs(math.log(each.ratio.estimate)))[:SPELT]
        parts = [f"{sum(e.verdict == v for e in own)} {v}" for v in ("better", "worse")]
        parts.append("most " + ", ".join(f"{change_text(each.ratio)} {_at(each)}" for each in strongest))
    else:
        parts = [f"{change_text(each.ratio)} {_at(each)}" for each in apart]
    for verdict, text in (("tie", "no difference told"), ("too few", "too few runs")):
        rest = [each for each in own if each.verdict == verdict]
        if rest and len(rest) <= SPELT_POINTS:
            parts.append(f"{text} {_at(*rest)}")
        elif rest:
            parts.append(f"{text} at {len(rest)} values")
    return ", ".join(parts)


def _at(*compared: Against) -> str:
    """``at 0.5 and 2``; with the names where more than one parameter was swept."""
    texts = []
    for each in compared:
        if len(each.point) == 1:
            texts.append(value_text(*each.point.values()))
        else:
            words = parameters_in_words(each.point)
            inner = ", ".join(f"{words[path]} = {value_text(value)}" for path, value in each.point.items())
            texts.append(f"({inner})")
    return f"at {listed(texts)}"


def _swept_text(results: Results) -> str:
    """``noise scale (0.5 to 4)``."""
    swept = swept_columns(results.trials)
    words = parameters_in_words(swept)
    parts = []
    for path in swept:
        values = list(results.trials[path].drop_duplicates())
        if len(values) < 2:
            continue
        shown = [value_text(value) for value in values]
        text = f"{shown[0]} to {shown[-1]}" if len(shown) > 2 else listed(shown)
        # The unit after the values, as in any sentence.
        name, _, value = setting_in_words(words[path], text).partition(" = ")
        parts.append(f"{name} ({value})")
    return listed(parts)
