"""Kind "speed": processor time against the reference's, in turns, so that a busy machine hurts both."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from slamcmp.grading.results.scoring import log_linear
from slamcmp.grading.run.trial import Trial, Verdict
from slamcmp.registry import test_kinds


@test_kinds.register("speed")
def speed(
    trial: Trial,
    *,
    procedure: str,
    rounds: Annotated[int, Ge(3)] = 5,
    full: Annotated[float, Gt(0)] = 3.0,
    zero: Annotated[float, Gt(0)] = 30.0,
) -> Verdict:
    """Median of the paired ratios of processor time; name the accuracy test in the key ``after``.

    Both sides run in a sandbox of the same making, in turns; the kernel counts.

    Args:
        trial: what is tested.
        procedure: ``name(implementation, generator)`` of ``cases.py``, with enough work to be measured.
        rounds: pairs of runs.
        full: ratio up to which all points are given.
        zero: ratio from which none are given.
    """
    if trial.short or trial.sandboxed_reference is None:
        # Outside of a sandbox there is nothing to be compared with.
        return Verdict(1.0, "Not measured.")
    run = trial.procedure(procedure)
    reference = trial.sandboxed_reference()
    ratios = []
    for generator in [trial.seeded(), *trial.seeded().spawn(rounds)]:
        taken = []
        for implementation in (trial.student, reference):
            before = implementation.cpu_s()
            run(implementation, np.random.default_rng(generator.bit_generator.state["state"]["state"]))
            taken.append(implementation.cpu_s() - before)
        ratios.append(taken[0] / max(taken[1], 1e-6))
    # The first round warms both up.
    ratio = float(np.median(ratios[1:]))
    credit = log_linear(ratio, full, zero)
    message = (
        f"Your code takes {ratio:.2g} times the processor time of the reference (all points up to {full:g})."
    )
    rank = (("time / reference", round(ratio, 2), "asc"),) if math.isfinite(ratio) else ()
    return Verdict(credit, message, leaderboard=rank)  # type: ignore[arg-type]
