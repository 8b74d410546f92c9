"""Kind "speed": processor time against the reference's, in turns, so that a busy machine hurts both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.closeness import largest_error
from slamcmp.grading.run.implementations import Remembered, Remembering
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.grading.run.watched import numbers_of
from slamcmp.grading.sandbox.errors import StudentError
from slamcmp.registry import test_kinds


@test_kinds.register("speed")
def speed(
    trial: Trial,
    *,
    procedure: str,
    rounds: Annotated[int, Ge(3)] = 5,
    full: Annotated[float, Gt(0)] = 3.0,
    zero: Annotated[float, Gt(0)] = 30.0,
    wrong: Annotated[float, Gt(0)] = 1e-3,
) -> Verdict:
    """Median of the paired ratios of processor time; name the accuracy test in the key ``after``.

    The answers that were timed are looked at afterwards: time spent on others earns nothing. Both sides run
    in a sandbox of the same making, in turns; the kernel counts.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator)`` of ``cases.py``, with enough work to be measured.
        rounds: pairs of runs.
        full: ratio up to which all points are given.
        zero: ratio from which none are given.
        wrong: largest error of a timed answer's entry, relative to its own scale, that still counts.
    """
    if trial.short or trial.sandboxed_reference is None:
        # Outside of a sandbox there is nothing to be compared with.
        return Verdict(1.0, "Not measured.")
    run = trial.procedure(procedure)
    reference = trial.sandboxed_reference()
    ratios = []
    for generator in [trial.seeded(), *trial.seeded().spawn(rounds)]:
        taken, answered = [], []
        for side in (trial.student, reference):
            implementation = Remembering(side)
            before = implementation.cpu_s()
            run(implementation, np.random.default_rng(generator.bit_generator.state["state"]["state"]))
            taken.append(implementation.cpu_s() - before)
            answered.append(implementation.answers)
        if (error := _largest_error(*answered)) > wrong:
            size = f"off by {error:.2g} times its size" if math.isfinite(error) else "of another kind"
            return Verdict(0.0, f"Not counted: an answer that was timed is {size}.")
        ratios.append(taken[0] / max(taken[1], 1e-6))
    # The first round warms both up.
    ratio = float(np.median(ratios[1:]))
    credit = log_linear(ratio, full, zero)
    message = (
        f"Your code takes {ratio:.2g} times the processor time of the reference (all points up to {full:g})."
    )
    rank = (("time / reference", round(ratio, 2), "asc"),) if math.isfinite(ratio) else ()
    return Verdict(credit, message, leaderboard=rank)  # type: ignore[arg-type]


def _largest_error(student: Sequence[Remembered], reference: Sequence[Remembered]) -> float:
    """Relative to the scale of each entry; infinite where an answer is built in another way."""
    if len(student) != len(reference):
        return math.inf
    largest = 0.0
    for given, wanted in zip(student, reference, strict=True):
        try:
            own, right = numbers_of(given.name, given.answer, wanted.answer)
        except StudentError:
            return math.inf
        if any(a.shape != b.shape for a, b in zip(own, right, strict=True)):
            return math.inf
        largest = max([largest, *map(largest_error, own, right)])
    return largest
