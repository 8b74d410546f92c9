"""Kind "must_fail": what an honest answer cannot do; who does it anyway did something else."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Gt

from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds


@test_kinds.register("must_fail")
def must_fail(
    trial: Trial,
    *,
    procedure: str,
    explanation: str,
    full: Annotated[float, Gt(1)] = 1.02,
    zero: Annotated[float, Gt(1)] = 1.2,
) -> Verdict:
    """Ask for an error that the method must make, and compare it with the reference's.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator) -> float > 0`` of ``cases.py``: the size of the failure.
        explanation: for the student, why the method has to fail here.
        full: ratio to the reference's failure, one way or the other, up to which all points are given.
        zero: ratio from which none are given.
    """
    measure, student = trial.procedure(procedure), Watched(trial.student, trial.reference)
    own = float(measure(student, trial.seeded()))
    expected = float(measure(trial.reference, trial.seeded()))
    ratio = max(own / expected, expected / own) if own > 0 else float("inf")
    credit = log_linear(ratio, full, zero)
    if credit == 1.0:
        return Verdict(1.0, f"Fails as the method has to: {own:.4g}. {explanation}")
    how = "smaller" if own < expected else "larger"
    return Verdict(
        credit,
        f"The failure that this method has to show is {own:.4g} with your code, {how} than the "
        f"{expected:.4g} of the method asked for. {explanation}",
    )
