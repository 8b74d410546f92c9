"""Kind "invariance": identities that the right equations keep, whatever the numbers are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from typing import Annotated

from annotated_types import Gt

from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.closeness import rounded_answers, rounding_explains
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.grading.run.watched import Watched
from slamcmp.registry import test_kinds


@test_kinds.register("invariance")
def invariance(
    trial: Trial,
    *,
    procedure: str,
    full: Annotated[float, Gt(0)] = 1e-8,
    zero: Annotated[float, Gt(0)] = 1e-2,
) -> Verdict:
    """Run a procedure that answers with residuals which should vanish.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator) -> dict[statement, residual]`` of ``cases.py``; every
            statement, a sentence that ought to be true, weighs the same. A function that does nothing keeps
            every statement: its share of the functions asked is taken off.
        full: residual up to which a statement counts as true; what rounding to single precision explains
            counts as true as well (closeness.py).
        zero: residual from which it counts nothing.
    """
    student = Watched(trial.student, trial.reference)
    residuals: dict[str, float] = trial.procedure(procedure)(student, trial.seeded())
    if student.not_finite:
        who = _list(student.not_finite)
        return Verdict(
            0.0, f"{who} gives numbers that are not finite (NaN or infinite): nothing holds of them."
        )
    shares = {what: log_linear(float(size), full, zero) for what, size in residuals.items()}
    if not trial.short and any(0 < share < 1 for share in shares.values()):
        enough = _enough(trial, procedure, residuals, full, zero)
        shares = {what: log_linear(float(size), enough[what], zero) for what, size in residuals.items()}
    lines = [
        f"This should hold, but {_by(residuals[what])}: {what}."
        for what, share in shares.items()
        if share < 1
    ]
    share = sum(shares.values()) / len(shares)
    if student.idle:
        # What does nothing keeps everything.
        share *= 1 - len(student.idle) / len(student.asked)
        who = _list(student.idle)
        lines.append(f"{who} gives back its arguments or zeros: that keeps everything, and earns nothing.")
    return Verdict(share, "\n".join(lines) or f"All hold: {'; '.join(residuals)}.")


def _enough(
    trial: Trial, procedure: str, residuals: Mapping[str, float], full: float, zero: float
) -> dict[str, float]:
    """How large each residual may be: as of the reference in single precision."""
    rounded = rounded_answers(lambda who: trial.procedure(procedure)(who, trial.seeded()), trial.reference)
    return {
        what: rounding_explains([float(each[(what,)]) for each in rounded if (what,) in each], full, zero)
        for what in residuals
    }


def _list(names: Set[str]) -> str:
    return ", ".join(sorted(names))


def _by(size: float) -> str:
    return f"is off by {size:.3g}" if math.isfinite(size) else "gives numbers that are not finite"
