"""Kind "swap_in": all parts together, with the reference in place of parts that are missing."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le

from slamcmp.grading.results.scoring import log_linear, relative_error
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds


@test_kinds.register("swap_in")
def swap_in(
    trial: Trial,
    *,
    procedure: str,
    functions: tuple[str, ...],
    own_share: Annotated[float, Ge(0), Le(1)] = 0.5,
    full: Annotated[float, Gt(0)] = 1e-6,
    zero: Annotated[float, Gt(0)] = 0.3,
) -> Verdict:
    """Run a procedure that calls the submission's functions, and compare its result with the reference's.

    A function that is missing, or of which nothing is written but ``raise NotImplementedError``, is replaced
    and costs nothing here; who has fewer than ``own_share`` of the functions earns nothing. Whatever a
    function that was written raises is its answer.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator) -> array`` of ``cases.py``.
        functions: what it calls.
        own_share: share of the functions that have to be the student's own.
        full: relative error of the result up to which all points are given.
        zero: relative error from which none are given.
    """
    mixed = _Mixed(trial)
    replaced = [name for name in functions if name in trial.missing]
    run = trial.procedure(procedure)
    result = np.asarray(run(mixed, trial.seeded()), dtype=np.float64)
    expected = np.asarray(run(trial.reference, trial.seeded()), dtype=np.float64)
    note = f" In place of your {', '.join(replaced)}, the reference was used." if replaced else ""
    if len(functions) - len(replaced) < own_share * len(functions):
        return Verdict(0.0, "Too few of the functions are there to put them together." + note)
    error = relative_error(result, expected)
    credit = log_linear(error, full, zero)
    if credit == 1.0:
        return Verdict(1.0, "Put together, your functions give the right result." + note)
    size = f"off by {100 * error:.2g} % of its largest entry" if np.isfinite(error) else "not finite"
    return Verdict(credit, f"Put together, the result is {size}.{note}")


class _Mixed(Watched):
    """The student's functions where there are any."""

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial.student, trial.reference)
        self._replaced = frozenset(trial.missing)

    def call(self, name: str, *arguments: Any) -> Any:
        return (
            self._reference.call(name, *arguments)
            if name in self._replaced
            else super().call(name, *arguments)
        )
