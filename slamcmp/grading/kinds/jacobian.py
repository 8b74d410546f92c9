"""Kind "jacobian": a derivative against central differences of the right function."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.results.scoring import as_array, leaves, log_linear
from slamcmp.grading.run.closeness import entry_errors, entry_scales, least_rounding, rounded_answers
from slamcmp.grading.run.trial import Case, Trial, Verdict
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.registry import test_kinds
from slamcmp.types import FloatArray


@test_kinds.register("jacobian")
def jacobian(
    trial: Trial,
    *,
    function: str,
    of: str,
    cases: str,
    argument: Annotated[int, Ge(0)] = 0,
    rows: tuple[str, ...],
    columns: tuple[str, ...],
    output: Annotated[int, Ge(0)] | None = None,
    moved: str | None = None,
    step: Annotated[float, Gt(0)] = 1e-5,
    full: Annotated[float, Gt(0)] = 1e-6,
    zero: Annotated[float, Gt(0)] = 1e-1,
) -> Verdict:
    """Differentiate the reference's function numerically and compare, entry by entry.

    Args:
        trial: what is tested.
        function: the derivative, called with the arguments of a case.
        of: the function that it is the derivative of, called with the same arguments.
        cases: ``name(reference, generator) -> list[Case]`` of ``cases.py``.
        argument: position of the argument by which it is differentiated.
        rows: what the outputs are called.
        columns: what the components of the argument are called.
        output: of a ``function`` with several answers, which one is the derivative; ``of`` then counts with
            its first.
        moved: ``name(argument, step) -> argument`` of ``cases.py``, for one that is no vector (a pose);
            without it the step (as many numbers as ``columns``) is added.
        step: half the distance of the central difference.
        full: error of every entry relative to its own scale up to which all points are given; what rounding
            to single precision explains counts as right as well (closeness.py).
        zero: error from which none are given.
    """
    todo: list[Case] = trial.procedure(cases)(trial.reference, trial.seeded())
    shape = (len(rows), len(columns))
    credits = []
    wrong = np.zeros(shape)
    turned = np.ones(shape, dtype=bool)
    right = [
        _central_difference(trial, of, case.arguments, argument, len(columns), moved, step) for case in todo
    ]
    for case, expected in zip(todo, right, strict=True):
        answer, what = trial.student.call(function, *case.arguments), f"the answer of {function}"
        if output is not None:
            what = f"answer {output + 1} of {function}"
            if not isinstance(answer, list | tuple) or len(answer) <= output:
                raise StudentError("ValueError", f"there is no {what}")
            answer = answer[output]
        given = as_array(answer, shape, what)
        scales = entry_scales(expected, right)
        size = entry_errors(given, expected, scales)
        enough = full
        if full < size.max() < zero and not trial.short:
            enough = _enough(trial, function, output, case, scales, full, zero)
        credits.append(log_linear(float(size.max()), enough, zero))
        bad = size > enough
        wrong += bad
        turned &= ~bad | (np.abs(given + expected) <= enough * scales)
    places = [
        f"∂{rows[row]}/∂{columns[column]} ({'its sign is wrong' if turned[row, column] else 'its value'})"
        for row, column in np.argwhere(wrong > 0)
    ]
    if not places:
        return Verdict(1.0, f"{function} agrees with central differences in {len(todo)} points.")
    return Verdict(
        sum(credits) / len(credits),
        f"{function} disagrees with central differences of {of} in {', '.join(places)}.",
    )


def _enough(
    trial: Trial, function: str, output: int | None, case: Case, scales: FloatArray, full: float, zero: float
) -> float:
    """The error up to which an entry is right: what rounding explains, or ``full``."""
    place = () if output is None else (output,)
    exact = np.asarray(dict(leaves(trial.reference.call(function, *case.arguments)))[place], dtype=np.float64)
    rounded = rounded_answers(lambda who: who.call(function, *case.arguments), trial.reference)
    return least_rounding(exact, [each[place] for each in rounded], scales, full, zero)


def _central_difference(
    trial: Trial,
    of: str,
    arguments: tuple[Any, ...],
    argument: int,
    count: int,
    moved: str | None,
    step: float,
) -> FloatArray:
    move = np.add if moved is None else trial.procedure(moved)
    columns = []
    for direction in step * np.eye(count):
        ends = []
        for sign in (1.0, -1.0):
            point = move(arguments[argument], sign * direction)
            changed = (*arguments[:argument], point, *arguments[argument + 1 :])
            value = trial.reference.call(of, *changed)
            ends.append(np.asarray(value[0] if isinstance(value, tuple) else value, dtype=np.float64))
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=-1)
