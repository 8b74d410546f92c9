"""The kind "jacobian" where the variable is a pose and the function answers with several things."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slamcmp.geometry import adjoint, exp, inverse, log, right_jacobian, se2
from slamcmp.grading.kinds.jacobian import jacobian
from slamcmp.grading.run.implementations import TrustedImplementation
from slamcmp.grading.run.trial import Case, Trial, Verdict
from slamcmp.grading.sandbox.errors import StudentError

T_0, T_1 = se2(1.0, 2.0, 0.3), se2(1.9, 2.3, 0.5)


def seen_from(T: Any, other: Any) -> tuple[Any, Any]:
    """``other`` in the axes of T, and the derivative by T's step."""
    r = log(inverse(T) @ other)
    return r, -np.linalg.inv(right_jacobian(r)) @ adjoint(inverse(other) @ T)


def judge(answer: Any, *, output: int = 1) -> Verdict:
    cases = ModuleType("cases")
    cases.points = lambda reference, generator: [Case((T_0, T_1))]  # type: ignore[attr-defined]
    cases.moved = lambda T, step: T @ exp(step)  # type: ignore[attr-defined]
    sides = [TrustedImplementation(SimpleNamespace(f=f)) for f in (answer, seen_from)]  # type: ignore[arg-type]
    trial = Trial(*sides, cases=cases, seeded=lambda: np.random.default_rng(0))
    names = ("x", "y", "heading")
    return jacobian(
        trial,
        function="f",
        of="f",
        cases="points",
        moved="moved",
        output=output,
        rows=names,
        columns=names,
        full=1e-5,
    )


def test_a_pose_is_moved_on_its_manifold() -> None:
    assert judge(seen_from).credit == 1.0


def test_the_entry_and_its_sign_are_told() -> None:
    def wrong(T: Any, other: Any) -> tuple[Any, Any]:
        r, J = seen_from(T, other)
        J[0, 1] = -J[0, 1]
        return r, J

    verdict = judge(wrong)
    assert verdict.credit == 0.0
    assert verdict.message.endswith("in ∂x/∂y (its sign is wrong).")


def test_an_answer_that_is_not_there_is_named() -> None:
    with pytest.raises(StudentError, match="there is no answer 2 of f"):
        judge(lambda T, other: log(inverse(T) @ other))
    with pytest.raises(StudentError, match="answer 1 of f has shape"):
        judge(seen_from, output=0)
