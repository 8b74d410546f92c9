"""What a student may see of an outcome: the one place that decides it, for every format."""

from __future__ import annotations

import math
from dataclasses import replace

from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, TestStatus
from slamcmp.support.messages import printable

STATUS_WORDS: dict[TestStatus, str] = {
    "passed": "passed",
    "partial": "partly passed",
    "failed": "failed",
    "error": "stopped with an error",
    "timed_out": "took too long",
    "skipped": "not run",
}
_UNTIL = {
    "hidden": "not shown",
    "after_due_date": "shown after the due date",
    "after_published": "shown when the grades are published",
}
TEXT_MAX = 8_000
"""Characters of one message; a longer one is the student's own flood."""
ROUNDING = 4
"""Decimals of every score that leaves the grader, so that a sum of what is shown is the total shown."""


def visible_tests(outcome: GradeOutcome) -> tuple[TestOutcome, ...]:
    """The tests that a student may see at once, without what is for the staff."""
    return tuple(without_staff_detail(test) for test in outcome.tests if test.visibility == "visible")


def without_staff_detail(test: TestOutcome) -> TestOutcome:
    """The test as its student may see it; a hidden one keeps nothing but its points."""
    if test.visibility == "hidden":
        return replace(
            test,
            name=f"Hidden test {test.number}",
            kind="",
            message="",
            staff_detail="",
            plots=(),
            causes=None,
        )
    return replace(test, staff_detail="")


def opening(outcome: GradeOutcome) -> str:
    """What comes before the tests: notes, what is missing, and which points are decided elsewhere.

    It tells neither the score of a test that is not visible nor the total.
    """
    shown = visible_tests(outcome)
    lines = [clean(note) for note in outcome.notes]
    if not outcome.complete:
        lines.append(
            "The grading did not come to its end. What was scored up to then counts; "
            "please tell the course staff."
        )
    hidden = [test for test in outcome.tests if test.visibility != "visible"]
    if shown:
        lines.append(
            f"Tests that you see: {points(total(shown))} of {points(total(shown, of='max_score'))} points."
        )
    for visibility, when in _UNTIL.items():
        of_kind = [test for test in hidden if test.visibility == visibility]
        if of_kind:
            count = "one more test" if len(of_kind) == 1 else f"{len(of_kind)} more tests"
            lines.append(f"{count}, {points(total(of_kind, of='max_score'))} points: {when}.".capitalize())
    if hidden:
        lines.append("Your mark depends on these too: passing every test that you see is not all of it.")
    return "\n".join(lines)


def total(tests: tuple[TestOutcome, ...] | list[TestOutcome], *, of: str = "score") -> float:
    """Sum of the rounded scores."""
    return round(math.fsum(rounded(getattr(test, of)) for test in tests), ROUNDING)


def rounded(score: float) -> float:
    """A score as every format writes it; what is no number counts nothing."""
    return round(score, ROUNDING) if math.isfinite(score) else 0.0


def points(score: float) -> str:
    """A score in words: at most two decimals."""
    return f"{score:.2f}".rstrip("0").rstrip(".")


def clean(text: str) -> str:
    """A text that may hold what a submission said, fit for every format."""
    shown = printable(text)
    return shown if len(shown) <= TEXT_MAX else shown[:TEXT_MAX] + f"\n[{len(shown) - TEXT_MAX} more]"
