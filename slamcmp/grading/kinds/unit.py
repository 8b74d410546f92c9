"""Kind "unit": single calls, each from the reference's state, so that no mistake is paid for twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt

from slamcmp.grading.results.scoring import as_array, leaves, log_linear, relative_error
from slamcmp.grading.run.trial import Case, Trial, Verdict
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.registry import test_kinds


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
        full: relative error up to which all points are given.
        zero: relative error from which none are given.
    """
    todo: list[Case] = trial.procedure(cases)(trial.reference, trial.seeded())
    credits: list[list[float]] = []
    right = 0
    told: list[tuple[list[Any], list[Any]]] = []
    worst: tuple[float, str] = (0.0, "")
    raised: dict[str, str] = {}
    for number, case in enumerate(todo):
        label = case.label or f"case {number + 1}"
        expected = [leaf for _, leaf in leaves(trial.reference.call(function, *case.arguments))]
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
        shares = []
        for name, value, wanted in zip(names, given, expected, strict=True):
            try:
                array = as_array(value, np.shape(wanted), f"{name} of {function}")
            except StudentError as error:
                raised.setdefault(error.message, label)
                shares.append(0.0)
                continue
            size = relative_error(array, np.asarray(wanted, dtype=np.float64))
            shares.append(log_linear(size, full, zero))
            if size > max(full, worst[0]):
                worst = (size, f"{name} of {function} is off by {_percent(size)} in {label}")
        credits.append(shares)
        told.append((given, expected))
        right += min(shares) == 1.0
    lines = [f"{right} of {len(todo)} calls of {function} are right."]
    if all(text.startswith("NotImplementedError") for text in raised) and len(raised) == 1 and right == 0:
        return Verdict(0.0, f"{function} is not implemented yet.")
    lines += [f"In {label}: {text}" for text, label in list(raised.items())[:2]]
    if worst[1]:
        lines.append(worst[1][0].upper() + worst[1][1:] + ".")
    if len(told) == len(todo) > 1:
        for index in np.flatnonzero(_constant(told)):
            for shares in credits:
                shares[index] = 0.0
    credit = sum(sum(shares) / len(shares) for shares in credits) / len(credits)
    return Verdict(credit, "\n".join(lines))


def _constant(told: Sequence[tuple[list[Any], list[Any]]]) -> list[bool]:
    """Of each output, whether it is the same in all calls and the reference's is not."""
    return [
        all(_equal(given[index], told[0][0][index]) for given, _ in told)
        and not all(_equal(expected[index], told[0][1][index]) for _, expected in told)
        for index in range(len(told[0][1]))
    ]


def _equal(first: Any, second: Any) -> bool:
    return np.shape(first) == np.shape(second) and bool(np.array_equal(first, second))


def _percent(size: float) -> str:
    if size >= np.inf:
        return "what is not finite"
    return f"{100 * size:.2g} % of its largest entry" if size < 1 else f"{size:.3g} times its largest entry"
