"""Name the likely cause of wrong answers: the known mistake that answers the same.

A mutant of the reference, made for the assignment, explains an answer when it gives the same numbers and
the reference does not. What no mutant explains is compared with what mistakes usually look like.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.implementations import Remembered
from slamcmp.types import FloatArray

SAME = 1e-6
"""Relative difference of answers that come from the same equations."""
_TURN = 2 * np.pi
_RUNAWAY = 1e6
"""Ratio to the right answer that no plain mistake reaches, but equations without a unique solution do."""

Place = tuple[str, tuple[int | str, ...]]
"""A function, and which of its outputs."""
Outputs = dict[int, Any]
"""One output of a function by the number of the call, from 0."""


@dataclass(frozen=True)
class Difference:
    """Where an output differs most from the reference's."""

    function: str
    call: int
    """From 1."""
    yours: float
    expected: float


def explain(
    student: Sequence[Remembered],
    reference: Sequence[Remembered],
    known: Iterable[tuple[str, Sequence[Remembered]]],
) -> list[str]:
    """Likely causes as messages for the student, the most telling first, at most two.

    Args:
        student: what the submission answered.
        reference: what the reference answered when asked the same.
        known: messages (templates over the fields of :class:`Difference`) with the answers of the mutant.
    """
    right = _by_place(reference, reference)
    own = _by_place(student, reference)
    wrong = [
        place
        for place in own
        if place in right and not _missing(own[place]) and not _same(own[place], right[place])
    ]
    if not wrong:
        return []
    candidates: list[tuple[str, list[Place]]] = []
    for message, answers in known:
        theirs = _by_place(answers, reference)
        explained = [
            place
            for place in wrong
            if place in theirs
            and _same(own[place], theirs[place])
            and _tells_apart(theirs[place], own[place], right[place])
        ]
        if explained:
            candidates.append((message, explained))
        if len(explained) == len(wrong):
            # The next mutant would be run only now, which takes far longer than all the rest.
            break
    found = [
        message.format(**vars(_largest(place, own[place], right[place])))
        for message, place in _fewest(candidates, wrong)
    ]
    if not found:
        found = [text for place in wrong if (text := _signature(place, own[place], right[place]))]
    return list(dict.fromkeys(found))[:2]


def _fewest(candidates: list[tuple[str, list[Place]]], wrong: Sequence[Place]) -> Iterator[tuple[str, Place]]:
    """Few mistakes that explain much: each time the one that explains most of what is left.

    Yields:
        its message and the first place that it explains.
    """
    left = set(wrong)
    while candidates and left:
        message, explained = max(candidates, key=lambda candidate: len(left.intersection(candidate[1])))
        here = [place for place in explained if place in left]
        if not here:
            return
        yield message, here[0]
        left.difference_update(here)


def _by_place(answers: Sequence[Remembered], reference: Sequence[Remembered]) -> dict[Place, Outputs]:
    """Outputs by function and number of the call.

    Only of calls that asked what the reference was asked: where a wrong answer came back as an argument, the
    next one has to differ.
    """
    asked: dict[str, list[Remembered]] = defaultdict(list)
    for answer in reference:
        asked[answer.name].append(answer)
    calls: dict[str, int] = defaultdict(int)
    places: dict[Place, Outputs] = defaultdict(dict)
    for answer in answers:
        number = calls[answer.name]
        calls[answer.name] += 1
        if number >= len(asked[answer.name]) or not _asked_alike(answer, asked[answer.name][number]):
            continue
        for path, leaf in leaves(answer.answer):
            places[answer.name, path][number] = leaf
    return places


def _asked_alike(first: Remembered, second: Remembered) -> bool:
    given, wanted = (list(leaves(list(each.arguments))) for each in (first, second))
    return len(given) == len(wanted) and all(
        where == there and _alike(a, b) for (where, a), (there, b) in zip(given, wanted, strict=True)
    )


def _missing(answers: Outputs) -> bool:
    """Whether it is a function that is still to be written: no mistake has to be looked for."""
    return all(
        isinstance(answer, str) and answer.startswith("NotImplementedError") for answer in answers.values()
    )


def _same(first: Outputs, second: Outputs) -> bool:
    # One side may have been asked less, or have stopped answering.
    return all(_alike(first[call], second[call]) for call in first if call in second)


def _tells_apart(theirs: Outputs, own: Outputs, right: Outputs) -> bool:
    """Whether a mistake shows in numbers: many a mistake ends in the same error of numpy's."""
    return any(
        not isinstance(theirs[call], str) and not _alike(theirs[call], right[call])
        for call in theirs
        if call in own and call in right
    )


def _alike(first: Any, second: Any) -> bool:
    if isinstance(first, str) or isinstance(second, str):
        return type(first) is type(second) and bool(first == second)
    a, b = _numbers(first), _numbers(second)
    if a is None or b is None or a.shape != b.shape:
        return a is None and b is None
    scale = np.abs(b[np.isfinite(b)]).max(initial=0.0)
    return bool(np.allclose(a, b, rtol=SAME, atol=SAME * scale + 1e-12, equal_nan=True))


def _numbers(value: Any) -> FloatArray | None:
    try:
        return None if value is None else np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _largest(place: Place, own: Outputs, right: Outputs) -> Difference:
    best, size = Difference(place[0], 1, float("nan"), float("nan")), -1.0
    for call in (call for call in own if call in right):
        a, b = _numbers(own[call]), _numbers(right[call])
        if a is None or b is None or a.shape != b.shape or a.size == 0:
            continue
        difference = np.nan_to_num(np.abs(a - b), nan=np.inf)
        index = np.unravel_index(int(np.argmax(difference)), a.shape)
        if difference[index] > size:
            size = float(difference[index])
            best = Difference(place[0], call + 1, float(a[index]), float(b[index]))
    return best


def _signature(place: Place, own: Outputs, right: Outputs) -> str:
    """What the difference looks like, or nothing."""
    function, path = place
    both = [(own[call], right[call]) for call in own if call in right]
    what = f"output {path[0] + 1} of {function}" if path and isinstance(path[0], int) else function
    pairs = [
        (a, b)
        for first, second in both
        if (a := _numbers(first)) is not None
        and (b := _numbers(second)) is not None
        and a.shape == b.shape
        and not _alike(a, b)
    ]
    free = "is something left out that ties the unknowns down, such as a prior or the noise?"
    if any(isinstance(answer, str) and "Singular matrix" in answer for answer, _ in both):
        return f"{function} solves equations that have no unique solution; {free}"
    if rows := _rows_signature(what, both):
        return rows
    if not pairs:
        return ""
    if any(not np.isfinite(a).all() for a, _ in pairs):
        return f"{what}: there are numbers that are not finite; is something divided by zero?"
    if all(not a.any() for a, _ in pairs):
        return f"{what} is all zeros; is it filled in?"
    if all(_alike(-a, b) for a, b in pairs):
        return f"{what} has the wrong sign throughout."
    if all(_alike(_nearest_turn(a, b), b) for a, b in pairs):
        return f"{what} is off by whole turns; wrap angles to (-π, π]."
    if all(_alike(np.degrees(b), a) or _alike(np.radians(b), a) for a, b in pairs):
        return f"{what} looks like degrees where radians are needed, or the other way round."
    if all(a.ndim == 2 and a.shape[0] == a.shape[1] and _alike(a.T, b) for a, b in pairs):
        return f"{what} is transposed."
    ratios = [float(np.vdot(a, b) / np.vdot(b, b)) for a, b in pairs if b.any()]
    if ratios and all(_alike(a, ratios[0] * b) for a, b in pairs):
        return f"{what} is {ratios[0]:.4g} times what it should be."
    if all(a.ndim == 2 and a.shape[1] == 2 and _alike(a[:, ::-1], b) for a, b in pairs):
        return f"{what} has its two columns swapped."
    squares = [(a, b) for a, b in pairs if a.ndim == 2 and a.shape[0] == a.shape[1]]
    if squares and all(_alike(a @ b, np.eye(len(a))) for a, b in squares):
        return f"{what} is the inverse of what it should be; are covariance and information mixed up?"
    if squares and all(_alike(b, b.T) and not _alike(a, a.T) for a, b in squares):
        return f"{what} is not symmetric, as a covariance has to be; is a transpose missing?"
    if all(np.abs(a).max() > _RUNAWAY * np.abs(b).max(initial=1.0) for a, b in pairs):
        return f"{what} is larger than what it should be by many orders of magnitude; {free}"
    return ""


def _rows_signature(what: str, both: Sequence[tuple[Any, Any]]) -> str:
    """Of answers that are lists of pairs: too many, or too few, and otherwise right."""
    more = fewer = 0
    for first, second in both:
        a, b = _numbers(first), _numbers(second)
        if a is None or b is None or a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
            return ""
        given, wanted = ({tuple(row) for row in rows.tolist()} for rows in (a, b))
        more += len(given - wanted)
        fewer += len(wanted - given)
    if more and not fewer:
        return f"{what} holds all that it should and {more} rows more; is a check left out?"
    if fewer and not more:
        return f"{what} lacks {fewer} rows and is right in the others; is a check too strict?"
    return ""


def _nearest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    shifted: FloatArray = a - _TURN * np.rint((a - b) / _TURN)
    return shifted
