"""Judge one test of one submission: credit, message, and the likely cause where marks are lost."""

from __future__ import annotations

import contextlib
import functools
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from slamcmp.errors import SlamcmpError
from slamcmp.grading.assignment.description import Assignment, Mutant, TestSpec
from slamcmp.grading.assignment.seeds import hidden_generator
from slamcmp.grading.results.outcome import TestOutcome, TestStatus
from slamcmp.grading.run.diagnosis import contradicted, explain, functions_asked
from slamcmp.grading.run.implementations import Remembered, Remembering, TrustedImplementation
from slamcmp.grading.run.slips.search import SlipSearch
from slamcmp.grading.run.trial import Implementation, Trial, Verdict
from slamcmp.grading.sandbox.errors import (
    ProtocolViolation,
    SandboxError,
    SandboxUnavailable,
    StudentCrashed,
    StudentError,
    StudentTimeout,
)

RIGHT = 1 - 1e-9
"""Credit from which a test counts as passed."""
BYTES_ONE, BYTES_ALL = 32 << 20, 64 << 20
"""Of answers kept for a diagnosis, in one test and of one submission."""
_SINGLE_CALLS = ("unit", "jacobian")
"""Kinds of test that ask for single calls, each from the reference's state."""

Sides = tuple[Implementation, Callable[[], Implementation] | None]
Rank = tuple[tuple[str, float, Literal["asc", "desc"]], ...]


class Runner(Protocol):
    """Somebody's code, started anew for each test."""

    digest: str
    missing: tuple[str, ...]
    notes: tuple[str, ...]
    """What the student has to know before the tests."""
    level: str
    proofs: Mapping[str, str]
    output: str
    """What the last test printed."""
    apart: bool
    """Whether its tests are judged in a process that may die: not for the course's own code."""

    def open(self) -> AbstractContextManager[Sides]:
        """The code's side of a test, and a function that starts the reference in like surroundings."""


@dataclass(frozen=True)
class Judged:
    """What came of one test."""

    test: TestOutcome
    leaderboard: Rank
    level: str
    """Of the sandbox, with its proofs."""
    proofs: Mapping[str, str]
    explained: bool = True
    """False: :meth:`Judge.explained` has more to say."""


class Judge:
    """The tests of one submission, one at a time and in their order.

    Args:
        assignment: what is asked.
        student: who the seeds are for.
        secret: what keeps them secret.
        runner: the submission.
        replays: what the reference and known mistakes answer, by test and mistake; filled as needed, to be
            shared by judges of the same assignment, student and secret.
        causes: whether likely causes are looked for.
    """

    def __init__(
        self,
        assignment: Assignment,
        student: str,
        secret: bytes,
        runner: Runner,
        replays: dict[tuple[str, str], list[Remembered]],
        *,
        causes: bool = True,
    ) -> None:
        self._assignment, self._student, self._secret, self._runner = assignment, student, secret, runner
        self._replays = replays
        self._looks_for_causes = causes
        self.tests = assignment.tests
        self._asked: list[tuple[TestSpec, Remembering]] = []
        """What the submission answered in the tests up to now."""
        self.evidence_lost = False
        """Whether answers of earlier tests are lost: they could speak against a cause, so none is named."""

    def judged(self, number: int, spec: TestSpec, shares: Mapping[str, float]) -> Judged:
        """Run a test.

        Args:
            number: its place, from 1.
            spec: the test.
            shares: credit of the tests before it, by name.

        Raises:
            SlamcmpError: the assignment or the machine is at fault.
            MemoryError: an answer took more memory than there is.
        """
        after = spec.fields.after
        if after is not None and shares[after] < 0.5:
            message = f"Run once the test {after!r} has earned half of its points."
            return self._told(without_points(number, spec, "skipped", message))
        started = time.monotonic()
        verdict: Verdict | None = None
        status: TestStatus = "failed"
        credit, detail = 0.0, ""
        try:
            with self._runner.open() as (implementation, reference_side):
                kept = sum(each.bytes_kept for _, each in self._asked)
                remembering = Remembering(implementation, bytes_max=min(BYTES_ONE, BYTES_ALL - kept))
                self._asked.append((spec, remembering))
                trial = self._trial(spec, remembering, reference_side, self._runner.missing)
                verdict = spec.plugin.target(trial, **spec.parameters)
            assert verdict is not None
            credit, message, detail = verdict.credit, verdict.message, verdict.detail
        except StudentTimeout as error:
            status, message = "timed_out", f"{error}. Is there a loop that does not end?"
        except (StudentCrashed, ProtocolViolation) as error:
            status, message = "error", str(error)
        except StudentError as error:
            message = _raised(error)
        except SandboxUnavailable:
            raise
        except SandboxError as error:
            status, message = "error", str(error)
        except (SlamcmpError, MemoryError):
            raise
        except Exception as error:
            # An answer that no check foresaw costs this test only.
            status, message = "error", "Your answer could not be used by this test."
            detail = "".join(traceback.format_exception(error))
        if not np.isfinite(credit):
            credit = 0.0
        credit = min(max(credit, 0.0), 1.0)
        if credit >= RIGHT:
            credit, status = 1.0, "passed"
        elif credit > 0:
            status = "partial"
        if self._runner.output:
            detail += f"\nprinted:\n{self._runner.output}"
        test = replace(
            without_points(number, spec, status, message),
            score=credit * spec.fields.points,
            staff_detail=detail.strip(),
            seconds=time.monotonic() - started,
            plots=verdict.plots if verdict is not None else (),
        )
        # Everybody reads the leaderboard: a value of a hidden test would tell how that one went.
        visible = spec.fields.visibility == "visible"
        rank = verdict.leaderboard if verdict is not None and visible else ()
        return self._told(test, rank, explained=status not in ("failed", "partial"))

    def explained(self, judged: Judged, spec: TestSpec) -> Judged:
        """The same, with the likely cause or the hint in front of the message."""
        started = time.monotonic()
        test = judged.test
        causes: list[str] = []
        detail = test.staff_detail
        try:
            causes = self._causes(spec) if self._looks_for_causes else []
        except MemoryError:
            raise
        except Exception as error:
            # Without an explanation the marks still stand.
            detail += "\n" + "".join(traceback.format_exception(error))
        hint = [spec.fields.hint] if spec.fields.hint and not causes else []
        message = "\n".join([*causes, test.message, *hint])
        seconds = test.seconds + time.monotonic() - started
        test = replace(
            test, message=message, staff_detail=detail.strip(), seconds=seconds, causes=tuple(causes)
        )
        return replace(judged, test=test, explained=True)

    def _told(self, test: TestOutcome, rank: Rank = (), *, explained: bool = True) -> Judged:
        return Judged(test, rank, self._runner.level, self._runner.proofs, explained)

    def _trial(
        self,
        spec: TestSpec,
        student: Implementation,
        reference_side: Callable[[], Implementation] | None = None,
        missing: tuple[str, ...] = (),
        *,
        short: bool = False,
    ) -> Trial:
        """What the test's kind is given."""
        return Trial(
            student=student,
            reference=TrustedImplementation(self._assignment.solution()),
            cases=self._assignment.cases,
            seeded=lambda: hidden_generator(
                self._secret, self._assignment.name, self._student, spec.fields.name
            ),
            sandboxed_reference=reference_side,
            missing=missing,
            short=short,
        )

    def _causes(self, spec: TestSpec) -> list[str]:
        """Why the answers of the last test are wrong, as far as the known mistakes tell.

        A mistake that earlier tests speak against (it would have spoilt an answer that was right) is none.
        """
        if not self._asked or self._asked[-1][0] is not spec:
            # It never came to ask anything.
            return []
        answers = self._asked[-1][1].answers
        asked = functions_asked(answers)
        known = (
            (mutant.message, self._replay(spec, mutant))
            for mutant in self._assignment.mutants
            if not self.evidence_lost and mutant.touches(asked) and not self._spoken_against(mutant, spec)
        )
        return explain(
            answers,
            self._replay(spec, None),
            known,
            right_answer=self._solution.answer,
            slip=self._slip,
        )

    @functools.cached_property
    def _solution(self) -> SlipSearch:
        return SlipSearch(self._assignment.solution_source, frozenset(self._assignment.fields.functions))

    def _slip(self, function: str) -> str | None:
        """The slip that explains a function's answers up to now, as a message; None: others are to blame."""
        calls = [each for _, asked in self._asked for each in asked.answers]
        if self._solution.others_to_blame(function, calls):
            return None
        if self.evidence_lost:
            return ""
        if not any(each.name == function and each.arguments for each in self._asked[-1][1].answers):
            return self._slip_of_object()
        said = self._solution.said(function, calls)
        return f"Your {function} answers as if {said}." if said else ""

    def _slip_of_object(self) -> str:
        """The same of the class of the objects that the last test drove."""
        for name in dict.fromkeys(drive.name for drive in self._asked[-1][1].drives):
            drives = [drive for _, asked in reversed(self._asked) for drive in asked.drives]
            if said := self._solution.said_of(name, drives):
                return f"Your {name} answers as if {said}."
        return ""

    def _spoken_against(self, mutant: Mutant, spec: TestSpec) -> bool:
        return any(
            contradicted(self._replay(earlier, mutant), answered.answers)
            for earlier, answered in self._asked
            if earlier is not spec and earlier.fields.kind in _SINGLE_CALLS
            if mutant.touches(functions_asked(answered.answers))
        )

    def _replay(self, spec: TestSpec, mutant: Mutant | None) -> list[Remembered]:
        """What the reference, or the reference with a mistake, answers in a test; run once."""
        key = spec.fields.name, mutant.name if mutant else ""
        if key not in self._replays:
            module = self._assignment.mutated(mutant) if mutant else self._assignment.solution()
            remembering = Remembering(TrustedImplementation(module))
            # A mutant may fail in any way that a submission may; what it answered before that counts, and
            # its warnings are nobody's.
            with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"):
                spec.plugin.target(self._trial(spec, remembering, short=True), **spec.parameters)
            self._replays[key] = remembering.answers
        return self._replays[key]


def without_points(number: int, spec: TestSpec, status: TestStatus, message: str) -> TestOutcome:
    """A test without points."""
    fields = spec.fields
    return TestOutcome(
        number=str(number),
        name=fields.name,
        kind=fields.kind,
        status=status,
        score=0.0,
        max_score=fields.points,
        visibility=fields.visibility,
        message=message,
        staff_detail="",
        seconds=0.0,
    )


def _raised(error: StudentError) -> str:
    if error.type_name == "NotImplementedError":
        where = f" ({error.frames[-1].function})" if error.frames else ""
        return f"Not implemented yet{where}."
    return error.text
