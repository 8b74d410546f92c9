"""Kind "jacobian": a derivative against central differences of the right function."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.results.scoring import as_array, log_linear
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
        full: error relative to the largest entry up to which all points are given.
        zero: error from which none are given.
    """
    todo: list[Case] = trial.procedure(cases)(trial.reference, trial.seeded())
    shape = (len(rows), len(columns))
    credits = []
    wrong = np.zeros(shape)
    turned = np.ones(shape, dtype=bool)
    for case in todo:
        expected = _central_difference(trial, of, case.arguments, argument, len(columns), moved, step)
        answer, what = trial.student.call(function, *case.arguments), f"the answer of {function}"
        if output is not None:
            what = f"answer {output + 1} of {function}"
            if not isinstance(answer, list | tuple) or len(answer) <= output:
                raise StudentError("ValueError", f"there is no {what}")
            answer = answer[output]
        given = as_array(answer, shape, what)
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
