"""Kind "jacobian": a derivative against central differences of the right function."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.scoring import FloatArray, as_array, log_linear
from slamcmp.grading.trial import Case, Trial, Verdict
from slamcmp.registry import test_kinds


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
        argument: position of the argument (a vector) by which it is differentiated.
        rows: what the outputs are called.
        columns: what the components of the argument are called.
        step: half the distance of the central difference.
        full: error relative to the largest entry up to which all points are given.
        zero: error from which none are given.
    """
    todo: list[Case] = trial.procedure(cases)(trial.reference, trial.seeded())
    shape = (len(rows), len(columns))
    credits = []
    wrong = np.zeros(shape)
    turned = np.ones(shape, dtype=bool)
    for case in todo:
        expected = _central_difference(trial, of, case.arguments, argument, step)
        given = as_array(trial.student.call(function, *case.arguments), shape, f"the answer of {function}")
        size = np.abs(given - expected) / np.abs(expected).max()
        size[~np.isfinite(given)] = np.inf
        credits.append(log_linear(float(size.max()), full, zero))
        bad = size > full
        wrong += bad
        turned &= ~bad | (np.abs(given + expected) <= full * np.abs(expected).max())
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


def _central_difference(
    trial: Trial, of: str, arguments: tuple[Any, ...], argument: int, step: float
) -> FloatArray:
    point = np.array(arguments[argument], dtype=np.float64)
    columns = []
    for index in range(point.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[index] += sign * step
            changed = (*arguments[:argument], moved, *arguments[argument + 1 :])
            ends.append(np.asarray(trial.reference.call(of, *changed), dtype=np.float64))
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=-1)
