"""Kind "swap_in": all parts together, with the reference in place of parts that are missing."""

from __future__ import annotations

import functools
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le

from slamcmp.grading.results.scoring import leaves
from slamcmp.grading.run.closeness import judge_entries, rounded_answers
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds
from slamcmp.types import FloatArray


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
        procedure: ``name(implementation, generator)`` of ``cases.py``: an array, or a list of arrays, each of
            one kind (poses, points, covariances), so that every entry can be judged by its own scale.
        functions: what it calls.
        own_share: share of the functions that have to be the student's own.
        full: error of every entry relative to its own scale up to which all points are given; what rounding
            to single precision explains counts as right as well (closeness.py).
        zero: error from which none are given.
    """
    mixed = _Mixed(trial)
    replaced = [name for name in functions if name in trial.missing]
    run = trial.procedure(procedure)
    result = _parts(run(mixed, trial.seeded()))
    expected = _parts(run(trial.reference, trial.seeded()))
    note = f" In place of your {', '.join(replaced)}, the reference was used." if replaced else ""
    if len(functions) - len(replaced) < own_share * len(functions):
        return Verdict(0.0, "Too few of the functions are there to put them together." + note)
    if result.keys() != expected.keys() or any(result[at].shape != expected[at].shape for at in expected):
        return Verdict(0.0, "Put together, the result has parts of another shape or number." + note)
    if trial.short:
        return Verdict(0.0, "Not compared.")
    shifted = functools.cache(lambda: rounded_answers(lambda who: run(who, trial.seeded()), trial.reference))
    alike = list(expected.values())
    found = [
        judge_entries(
            result[at],
            wanted,
            alike=[other for other in alike if other.ndim == wanted.ndim],
            shifted=lambda at=at: [each[at] for each in shifted() if at in each],  # type: ignore[misc]
            full=full,
            zero=zero,
        )
        for at, wanted in expected.items()
    ]
    worst = min(found, key=lambda part: part.share)
    if worst.share == 1.0:
        return Verdict(1.0, "Put together, your functions give the right result." + note)
    error = max(part.error for part in found)
    size = f"off by {100 * error:.2g} % of the size of an entry" if np.isfinite(error) else "not finite"
    return Verdict(worst.share, f"Put together, the result is {size}.{note}")


def _parts(result: Any) -> dict[tuple[int | str, ...], FloatArray]:
    """The arrays of a result by their place in it."""
    return {path: np.asarray(leaf, dtype=np.float64) for path, leaf in leaves(result)}


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
