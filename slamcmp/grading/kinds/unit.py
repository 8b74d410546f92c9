"""Kind "unit": single calls, each from the reference's state, so that no mistake is paid for twice."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt

from slamcmp.grading.results.scoring import as_array, leaves
from slamcmp.grading.run.closeness import Closeness, judge_entries, largest_error, rounded_answers
from slamcmp.grading.run.trial import Case, Trial, Verdict
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.registry import test_kinds
from slamcmp.types import FloatArray


@test_kinds.register("unit")
def unit(
    trial: Trial,
    *,
    function: str,
    cases: str,
    outputs: tuple[str, ...] = (),
    full: Annotated[float, Gt(0)] = 1e-8,
    zero: Annotated[float, Gt(0)] = 1e-2,
) -> Verdict:
    """Compare answers with the reference's, output by output, with log-linear credit.

    An output that is the same in every call, where the reference's is not, was not computed and earns
    nothing.

    Args:
        trial: what is tested.
        function: the function to call.
        cases: ``name(reference, generator) -> list[Case]`` of ``cases.py``.
        outputs: what the function's outputs are called, for messages.
        full: error of every entry relative to its own scale up to which all points are given; what rounding
            to single precision explains counts as right as well (closeness.py).
        zero: error from which none are given.
    """
    todo: list[Case] = trial.procedure(cases)(trial.reference, trial.seeded())
    answers = [trial.reference.call(function, *case.arguments) for case in todo]
    wanted = [[np.asarray(leaf, dtype=np.float64) for _, leaf in leaves(answer)] for answer in answers]
    credits: list[list[float]] = []
    right = 0
    told: list[tuple[list[Any], list[Any]]] = []
    worst: tuple[float, str] = (0.0, "")
    raised: dict[str, str] = {}
    for number, case in enumerate(todo):
        label = case.label or f"case {number + 1}"
        expected = wanted[number]
        names = outputs or tuple(f"output {index + 1}" for index in range(len(expected)))
        try:
            answer = trial.student.call(function, *case.arguments)
            given = list(answer) if isinstance(answer, list | tuple) and len(expected) > 1 else [answer]
            if len(given) != len(expected):
                raise StudentError(
                    "ValueError", f"{function} returned {len(given)} values; needed: {', '.join(names)}"
                )
        except StudentError as error:
            raised.setdefault(error.text, label)
            credits.append([0.0])
            continue
        shares, usable = [], True
        shifted = functools.cache(lambda case=case: _shifted(trial, function, case))
        for index, (name, value) in enumerate(zip(names, given, strict=True)):
            try:
                array = as_array(value, expected[index].shape, f"{name} of {function}")
            except StudentError as error:
                raised.setdefault(error.message, label)
                shares.append(0.0)
                usable = False
                continue
            found = judge_entries(
                array,
                expected[index],
                alike=[each[index] for each in wanted if len(each) > index],
                shifted=lambda index=index, shifted=shifted: [each[index] for each in shifted()],  # type: ignore[misc]
                full=full,
                zero=zero,
            )
            shares.append(found.share)
            if found.share < 1 and found.error > worst[0]:
                worst = (
                    found.error,
                    f"{_entry(name, found)} of {function} is {_off(found.error)} in {label}",
                )
        credits.append(shares)
        # Answers of another shape are not kept: they may be of any size.
        told.append((given if usable else [], expected))
        right += min(shares) == 1.0
    lines = [f"{right} of {len(todo)} calls of {function} are right."]
    if all(text.startswith("NotImplementedError") for text in raised) and len(raised) == 1 and right == 0:
        return Verdict(0.0, f"{function} is not implemented yet.")
    lines += [f"In {label}: {text}" for text, label in list(raised.items())[:2]]
    if worst[1]:
        lines.append(worst[1][0].upper() + worst[1][1:] + ".")
    if len(told) == len(todo) > 1 and all(given for given, _ in told):
        for index in np.flatnonzero(_constant(told)).tolist():
            for shares in credits:
                shares[index] = 0.0
    credit = sum(sum(shares) / len(shares) for shares in credits) / len(credits)
    return Verdict(credit, "\n".join(lines))


def _constant(told: Sequence[tuple[list[Any], list[FloatArray]]]) -> list[bool]:
    """Of each output, whether it is the same in all calls and the reference's is not."""
    return [
        all(_equal(given[index], told[0][0][index]) for given, _ in told)
        and any(_differ(expected[index], told[0][1][index]) for _, expected in told)
        for index in range(len(told[0][1]))
    ]


def _equal(first: Any, second: Any) -> bool:
    return np.shape(first) == np.shape(second) and bool(np.array_equal(first, second))


def _differ(first: FloatArray, second: FloatArray) -> bool:
    """By more than what single precision may hide."""
    return first.shape != second.shape or largest_error(first, second) > 1e-5


def _shifted(trial: Trial, function: str, case: Case) -> list[list[FloatArray]]:
    """The outputs of the reference in single precision, several times."""
    if trial.short:
        return []
    found = rounded_answers(lambda who: who.call(function, *case.arguments), trial.reference)
    return [list(answer.values()) for answer in found]


def _entry(name: str, found: Closeness) -> str:
    return f"{name} [{', '.join(map(str, found.index))}]" if found.index else name


def _off(size: float) -> str:
    if size >= np.inf:
        return "not finite"
    return f"off by {100 * size:.2g} % of its size" if size < 1 else f"off by {size:.3g} times its size"
