"""Name the likely cause of wrong answers: the known mistake that answers the same.

A mutant of the reference, made for the assignment, explains an answer when it gives the same numbers and
the reference does not. What no mutant explains is compared with what mistakes usually look like.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slamcmp.grading.implementations import Remembered
from slamcmp.grading.scoring import FloatArray, leaves

SAME = 1e-6
"""Relative difference of answers that come from the same equations."""
_TURN = 2 * np.pi
_RUNAWAY = 1e6
"""Ratio to the right answer that no plain mistake reaches, but equations without a unique solution do."""

Place = tuple[str, tuple[int | str, ...]]
"""A function, and which of its outputs."""


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
    own, right = _by_place(student), _by_place(reference)
    wrong = [
        place
        for place in own
        if place in right and not _missing(own[place]) and not _same(own[place], right[place])
    ]
    if not wrong:
        return []
    found: list[str] = []
    unexplained = list(wrong)
    for message, answers in known:
        theirs = _by_place(answers)
        explained = [
            place
            for place in unexplained
            if place in theirs
            and _same(own[place], theirs[place])
            and _tells_apart(theirs[place], right[place])
        ]
        if explained:
            at = _largest(explained[0], own[explained[0]], right[explained[0]])
            found.append(message.format(**vars(at)))
            unexplained = [place for place in unexplained if place not in explained]
        if not unexplained:
            # The next mutant would be run only now, which takes far longer than all the rest.
            break
    if not found:
        found = [text for place in wrong if (text := _signature(place, own[place], right[place]))]
    return list(dict.fromkeys(found))[:2]


def _by_place(answers: Sequence[Remembered]) -> dict[Place, list[Any]]:
    places: dict[Place, list[Any]] = defaultdict(list)
    for answer in answers:
        for path, leaf in leaves(answer.answer):
            places[answer.name, path].append(leaf)
    return places


def _missing(answers: Sequence[Any]) -> bool:
    """Whether it is a function that is still to be written: no mistake has to be looked for."""
    return all(isinstance(answer, str) and answer.startswith("NotImplementedError") for answer in answers)


def _same(first: Sequence[Any], second: Sequence[Any]) -> bool:
    # One side may have been asked less, or have stopped answering.
    return all(_alike(a, b) for a, b in zip(first, second, strict=False))


def _tells_apart(theirs: Sequence[Any], right: Sequence[Any]) -> bool:
    """Whether a mistake shows in numbers: many a mistake ends in the same error of numpy's."""
    return any(not isinstance(a, str) and not _alike(a, b) for a, b in zip(theirs, right, strict=False))


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


def _largest(place: Place, own: Sequence[Any], right: Sequence[Any]) -> Difference:
    best, size = Difference(place[0], 1, float("nan"), float("nan")), -1.0
    for call, (first, second) in enumerate(zip(own, right, strict=False), start=1):
        a, b = _numbers(first), _numbers(second)
        if a is None or b is None or a.shape != b.shape or a.size == 0:
            continue
        difference = np.nan_to_num(np.abs(a - b), nan=np.inf)
        index = np.unravel_index(int(np.argmax(difference)), a.shape)
        if difference[index] > size:
            size = float(difference[index])
            best = Difference(place[0], call, float(a[index]), float(b[index]))
    return best


def _signature(place: Place, own: Sequence[Any], right: Sequence[Any]) -> str:
    """What the difference looks like, or nothing."""
    function, path = place
    what = f"output {path[0] + 1} of {function}" if path and isinstance(path[0], int) else function
    pairs = [
        (a, b)
        for first, second in zip(own, right, strict=False)
        if (a := _numbers(first)) is not None
        and (b := _numbers(second)) is not None
        and a.shape == b.shape
        and not _alike(a, b)
    ]
    free = "is something left out that ties the unknowns down, such as a prior or the noise?"
    if any(isinstance(answer, str) and "Singular matrix" in answer for answer in own):
        return f"{function} solves equations that have no unique solution; {free}"
    if rows := _rows_signature(what, own, right):
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


def _rows_signature(what: str, own: Sequence[Any], right: Sequence[Any]) -> str:
    """Of answers that are lists of pairs: too many, or too few, and otherwise right."""
    more = fewer = 0
    for first, second in zip(own, right, strict=False):
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
