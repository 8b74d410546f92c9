"""Name the likely cause of wrong answers: the known mistake that answers the same, everywhere.

Each function is looked at by itself. A mutant of the reference, made for the assignment, explains a
function's answers only if it gives the same numbers in *every* output of *every* call that both were asked
alike, and the reference does not: one output that it does not reproduce speaks against it, whatever the
others say. Where several mistakes would explain the answers, or none, nothing is claimed. What no mutant
explains is looked for among slips of the solution (slips/), and then compared with what mistakes usually
look like, which says what is seen and not why.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.closeness import entry_errors, entry_scales
from slamcmp.grading.run.implementations import Remembered
from slamcmp.types import FloatArray

SAME = 1e-6
"""Relative difference of answers that come from the same equations."""
SAME_ENTRY = 1e-5
"""The same for each entry, relative to its own scale."""
_EQUAL = 1e-12
CAUSES = 2
"""Most causes that are named of one test."""
_TURN = 2 * np.pi
_RUNAWAY = 1e6
"""Ratio to the right answer that no plain mistake reaches, but equations without a unique solution do."""

Path = tuple[int | str, ...]
"""Which output of a function."""
Calls = Mapping[int, Remembered]
"""The calls of one function by their number, from 0."""


@dataclass(frozen=True)
class Difference:
    """Where a function's answers differ most from the reference's."""

    function: str
    call: int
    """From 1."""
    yours: float
    expected: float


def explain(
    student: Sequence[Remembered],
    reference: Sequence[Remembered],
    known: Iterable[tuple[str, Sequence[Remembered]]],
    *,
    right_answer: Callable[[Remembered], Any] | None = None,
    slip: Callable[[str], str | None] | None = None,
) -> list[str]:
    """Likely causes as messages for the student, in the order of the functions asked, at most ``CAUSES``.

    Args:
        student: what the submission answered.
        reference: what the reference answered when asked the same.
        known: messages (templates over the fields of :class:`Difference`) with the answers of the mutant.
        right_answer: what the reference answers to the very same question. What it was asked in its own run
            is the same up to rounding only, and an answer that is the difference of its arguments is not.
        slip: what may be said of a function that no known mistake explains, by slips/; None: nothing at all.
    """
    own, right = _by_function(student), _by_function(reference)
    if right_answer is not None:
        right = _asked_again(own, right, right_answer)
    wrong = {
        function: calls
        for function in own
        if function in right
        and not _still_to_be_written(own[function])
        and (calls := _wrong_calls(own[function], right[function]))
    }
    if not wrong:
        return []
    explaining: dict[str, list[str]] = {function: [] for function in wrong}
    for message, answers in known:
        theirs = _by_function(answers)
        for function, calls in wrong.items():
            if _explains(theirs.get(function, {}), own[function], right[function], calls):
                explaining[function].append(message)
    found: list[str] = []
    for function, calls in wrong.items():
        messages = list(dict.fromkeys(explaining[function]))
        if len(messages) == 1:
            place = _largest(function, calls, own[function], right[function])
            found.append(messages[0].format(**vars(place)))
        elif not messages:
            said = slip(function) if slip is not None else ""
            if said == "":
                found += _signatures(function, calls, own[function], right[function])
            elif said is not None:
                found.append(said)
    return list(dict.fromkeys(found))[:CAUSES]


def functions_asked(answers: Sequence[Remembered]) -> frozenset[str]:
    """Names of the functions called; empty where frames were handed to an object, which may call any."""
    named = frozenset(each.name for each in answers)
    # A frame is remembered without arguments.
    return named if all(each.arguments for each in answers) else frozenset()


def contradicted(theirs: Sequence[Remembered], student: Sequence[Remembered]) -> bool:
    """Whether a mistake answers otherwise than the student where both were asked the same.

    Whether the student is right there does not matter: it is not this mistake alone.
    """
    mistaken, own = _by_function(theirs), _by_function(student)
    return any(
        number in own.get(function, {})
        and _asked_alike(call, own[function][number])
        and not answered_alike(call.answer, own[function][number].answer)
        for function, calls in mistaken.items()
        for number, call in calls.items()
    )


def _by_function(answers: Sequence[Remembered]) -> dict[str, dict[int, Remembered]]:
    calls: dict[str, dict[int, Remembered]] = defaultdict(dict)
    for answer in answers:
        calls[answer.name][len(calls[answer.name])] = answer
    return calls


def _asked_again(
    own: Mapping[str, Calls], right: Mapping[str, Calls], right_answer: Callable[[Remembered], Any]
) -> dict[str, dict[int, Remembered]]:
    """The reference's answers, to the student's own questions where those are the same up to rounding."""
    return {
        function: {
            number: replace(call, answer=right_answer(asked[number]))
            if (asked := own.get(function, {})).get(number) is not None
            and call.arguments
            and _asked_alike(asked[number], call)
            and not answered_alike(asked[number].answer, call.answer)
            else call
            for number, call in calls.items()
        }
        for function, calls in right.items()
    }


def _wrong_calls(own: Calls, right: Calls) -> list[int]:
    """The calls with a wrong answer, of those that asked what the reference was asked.

    Where a wrong answer came back as an argument, the next answer has to differ.
    """
    return [
        number
        for number, answer in own.items()
        if number in right
        and _asked_alike(answer, right[number])
        and not answered_alike(answer.answer, right[number].answer)
    ]


def _explains(theirs: Calls, own: Calls, right: Calls, wrong: Sequence[int]) -> bool:
    """Whether a mistake answers as the student does wherever both were asked the same.

    A run of the mistake may be shorter than the student's, or have stopped answering: what it was not asked
    speaks neither for nor against it, but it has to show in something that the student answered wrong.
    """
    common = [number for number in own if number in theirs and _asked_alike(own[number], theirs[number])]
    told_apart = False
    for number in common:
        if not answered_alike(own[number].answer, theirs[number].answer):
            return False
        if number in right and number in wrong:
            told_apart = told_apart or differs_in_numbers(theirs[number].answer, right[number].answer)
    return told_apart and all(number in common for number in wrong if number in theirs)


def answered_alike(first: Any, second: Any) -> bool:
    """Whether two answers are the same up to rounding, in every output."""
    one, other = dict(leaves(first)), dict(leaves(second))
    return one.keys() == other.keys() and all(_alike(one[path], other[path]) for path in one)


def differs_in_numbers(theirs: Any, right: Any) -> bool:
    """Whether a mistake shows in numbers: many a mistake ends in the same error of numpy's."""
    if isinstance(theirs, str):
        return False
    wanted = dict(leaves(right))
    return any(
        _numbers(leaf) is not None and not (path in wanted and _alike(leaf, wanted[path]))
        for path, leaf in leaves(theirs)
    )


def _asked_alike(first: Remembered, second: Remembered) -> bool:
    given, wanted = (list(leaves(list(each.arguments))) for each in (first, second))
    return len(given) == len(wanted) and all(
        where == there and _alike(a, b) for (where, a), (there, b) in zip(given, wanted, strict=True)
    )


def _still_to_be_written(calls: Calls) -> bool:
    """Whether it is a function that is still to be written: no mistake has to be looked for."""
    return all(
        isinstance(call.answer, str) and call.answer.startswith("NotImplementedError")
        for call in calls.values()
    )


def _alike(first: Any, second: Any) -> bool:
    if isinstance(first, str) or isinstance(second, str):
        return type(first) is type(second) and bool(first == second)
    a, b = _numbers(first), _numbers(second)
    if a is None or b is None or a.shape != b.shape:
        return a is None and b is None
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(a - b)
        largest = _largest_finite(b)
        # np.allclose takes five times as long for the small arrays that these are.
        close = apart <= 1e-12 + SAME * largest
        if not (close.all() or (close | (a == b) | (np.isnan(a) & np.isnan(b))).all()):
            return False
        if (apart <= _EQUAL * largest).all():
            return True
    # A small entry may be another, though it is nothing beside a large one.
    return bool((entry_errors(a, b, entry_scales(b)) <= SAME_ENTRY).all())


def _largest_finite(values: FloatArray) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return largest if np.isfinite(largest) else float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _numbers(value: Any) -> FloatArray | None:
    try:
        return None if value is None else np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def _largest(function: str, wrong: Sequence[int], own: Calls, right: Calls) -> Difference:
    best, size = Difference(function, wrong[0] + 1, float("nan"), float("nan")), -1.0
    for call in wrong:
        for a, b in _pairs(own[call].answer, right[call].answer):
            difference = np.nan_to_num(np.abs(a - b), nan=np.inf)
            index = np.unravel_index(int(np.argmax(difference)), a.shape)
            if difference[index] > size:
                size = float(difference[index])
                best = Difference(function, call + 1, float(a[index]), float(b[index]))
    return best


def _pairs(first: Any, second: Any) -> list[tuple[FloatArray, FloatArray]]:
    """The outputs of a call that are numbers of the same shape on both sides and differ."""
    wanted = dict(leaves(second))
    return [
        (a, b)
        for path, leaf in leaves(first)
        if path in wanted
        and (a := _numbers(leaf)) is not None
        and (b := _numbers(wanted[path])) is not None
        and a.shape == b.shape
        and a.size
        and not _alike(a, b)
    ]


def _signatures(function: str, wrong: Sequence[int], own: Calls, right: Calls) -> list[str]:
    """What the differences of a function look like, if every output that is wrong looks like something."""
    if any(isinstance(own[call].answer, str) and "Singular matrix" in own[call].answer for call in wrong):
        return [f"{function} solves equations that have no unique solution."]
    texts = []
    for path in dict.fromkeys(path for call in wrong for path, _ in leaves(right[call].answer)):
        both = [
            (given[path], wanted[path])
            for call in wrong
            if path in (given := dict(leaves(own[call].answer)))
            and path in (wanted := dict(leaves(right[call].answer)))
        ]
        if any(not _alike(a, b) for a, b in both):
            what = f"output {path[0] + 1} of {function}" if path and isinstance(path[0], int) else function
            texts.append(_rows_signature(what, both) or _signature(what, both))
    return texts if all(texts) else []


def _signature(what: str, both: Sequence[tuple[Any, Any]]) -> str:
    """What the difference of one output looks like, or nothing: what is seen, no guess at why."""
    pairs = []
    for first, second in both:
        if _alike(first, second):
            continue
        a, b = _numbers(first), _numbers(second)
        if a is None or b is None or a.shape != b.shape:
            return ""
        pairs.append((a, b))
    if any(not np.isfinite(a).all() for a, _ in pairs):
        return f"{what} holds numbers that are not finite (NaN or infinite)."
    if all(not a.any() for a, _ in pairs):
        return f"{what} is all zeros."
    if all(_alike(-a, b) for a, b in pairs):
        return f"{what} has the wrong sign throughout."
    square = all(a.ndim == 2 and a.shape[0] == a.shape[1] for a, _ in pairs)
    if square and all(_alike(a.T, b) for a, b in pairs):
        return f"{what} is transposed."
    ratios = [float(np.vdot(a, b) / np.vdot(b, b)) for a, b in pairs if b.any()]
    if ratios and all(_alike(a, ratios[0] * b) for a, b in pairs):
        return f"{what} is {ratios[0]:.4g} times what it should be."
    if all(a.ndim == 2 and a.shape[1] == 2 and _alike(a[:, ::-1], b) for a, b in pairs):
        return f"{what} has its two columns swapped."
    if square and all(_alike(a @ b, np.eye(len(a))) for a, b in pairs):
        return f"{what} is the inverse of what it should be."
    if entries := _entries_signature(what, pairs):
        return entries
    if square and all(_alike(b, b.T) and not _alike(a, a.T) for a, b in pairs):
        return f"{what} is not symmetric, as it has to be."
    if all(np.abs(a).max() > _RUNAWAY * np.abs(b).max(initial=1.0) for a, b in pairs):
        return f"{what} is larger than what it should be by many orders of magnitude."
    return ""


def _entries_signature(what: str, pairs: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """The same for some entries of an output, where the others are right."""
    shapes = {a.shape for a, _ in pairs}
    if len(shapes) > 1 or not next(iter(shapes)):
        return ""
    yours, expected = (np.stack(side) for side in zip(*pairs, strict=True))
    scale = np.abs(expected).max(axis=0)
    off = np.abs(yours - expected) > SAME * np.maximum(scale, 1e-6 * scale.max(initial=0.0)) + 1e-12
    if not off.any():
        return ""
    a, b = yours[off], expected[off]
    names = ", ".join(str(index.tolist()) for index in np.argwhere(off.any(axis=0))[:6])
    whose = what if off.all() else f"{what} in {names}"
    if _alike(_nearest_turn(a, b), b):
        return f"{whose} is off by whole turns; angles are wrapped to (-π, π]."
    if _alike(np.degrees(b), a):
        return f"{whose} is in degrees where radians are needed."
    if _alike(np.radians(b), a):
        return f"{whose} looks like radians that were turned into radians once more."
    if not off.all() and _alike(-a, b):
        return f"{whose} has the wrong sign."
    return ""


def _rows_signature(what: str, both: Sequence[tuple[Any, Any]]) -> str:
    """Of answers that are lists of pairs: too many, or too few, and otherwise right."""
    more = fewer = 0
    for first, second in both:
        a, b = _numbers(first), _numbers(second)
        if a is None or b is None or a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
            return ""
        given, wanted = (Counter(tuple(row) for row in rows.tolist()) for rows in (a, b))
        more += (given - wanted).total()
        fewer += (wanted - given).total()
    if more and not fewer:
        return f"{what} holds all that it should and {more} rows more."
    if fewer and not more:
        return f"{what} lacks {fewer} rows and is right in the others."
    return ""


def _nearest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    shifted: FloatArray = a - _TURN * np.rint((a - b) / _TURN)
    return shifted
