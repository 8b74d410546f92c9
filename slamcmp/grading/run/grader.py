"""Grade one submission: every test in a sandbox of its own, and the outcome written after each."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

import slamcmp
from slamcmp.errors import SlamcmpError
from slamcmp.grading.assignment.description import (
    Assignment,
    Mutant,
    TestSpec,
    find_assignment,
    load_assignment,
)
from slamcmp.grading.assignment.seeds import check_secret, hidden_generator
from slamcmp.grading.hand_in.submission import Submission, SubmissionError, load_submission
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, TestStatus, save_outcome
from slamcmp.grading.run.diagnosis import contradicted, explain, functions_asked
from slamcmp.grading.run.implementations import (
    Remembered,
    Remembering,
    SandboxedImplementation,
    TrustedImplementation,
)
from slamcmp.grading.run.source_reader import read_source, told
from slamcmp.grading.run.trial import Implementation, Trial, Verdict
from slamcmp.grading.sandbox.errors import (
    ProtocolViolation,
    SandboxError,
    SandboxUnavailable,
    StudentCrashed,
    StudentError,
    StudentTimeout,
)
from slamcmp.grading.sandbox.session import SandboxSession

RIGHT = 1 - 1e-9
"""Credit from which a test counts as passed."""
_OUTPUT_KEPT = 2000
_SINGLE_CALLS = ("unit", "jacobian")
"""Kinds of test that ask for single calls, each from the reference's state."""

Sides = tuple[Implementation, Callable[[], Implementation] | None]


def grade(
    assignment_folder: Path,
    submission_path: Path,
    *,
    student: str,
    secret: bytes,
    out: Path | None,
    accept_weak_sandbox: bool = False,
    progress: Callable[[GradeOutcome], None] | None = None,
) -> GradeOutcome:
    """Run all tests of an assignment on a submission.

    Args:
        assignment_folder: the assignment's folder, or a shipped one's name.
        submission_path: a .py file, a folder, a zip or a notebook.
        student: whose it is; decides the seeds together with the secret.
        secret: the course's, at least 16 bytes.
        out: JSON file for the outcome, written again after each test.
        accept_weak_sandbox: grade where the machine cannot keep hidden tests from the submission.
        progress: called with the outcome up to now after each test.

    Raises:
        UsageError, MissingDataError: the assignment, the secret or the machine is at fault; a fault of the
            submission is part of the outcome.
    """
    assignment = load_assignment(find_assignment(assignment_folder))
    grading = Grading(assignment, student, check_secret(secret))

    def keep(outcome: GradeOutcome) -> None:
        if out is not None:
            save_outcome(outcome, out)
        if progress is not None:
            progress(outcome)

    try:
        submission = load_submission(submission_path, entry=assignment.fields.entry)
    except SubmissionError as error:
        outcome = grading.refused(str(error))
        keep(outcome)
        return outcome
    return grading.run(Sandboxed(assignment, submission, accept_weak_sandbox), keep)


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

    def open(self) -> AbstractContextManager[Sides]:
        """The code's side of a test, and a function that starts the reference in like surroundings."""


class Sandboxed:
    """A submission, to be run in a new sandbox for each test."""

    def __init__(self, assignment: Assignment, submission: Submission, accept_weak: bool) -> None:
        self._assignment = assignment
        self._submission = submission
        self._accept_weak = accept_weak
        self.digest = submission.digest
        reading = read_source(submission, assignment.fields.functions)
        self.missing = reading.unwritten
        self.notes: tuple[str, ...] = (told(reading.left_out),) if reading.left_out else ()
        self.level = "not started"
        self.proofs: Mapping[str, str] = {}
        self.output = ""

    @contextlib.contextmanager
    def open(self) -> Iterator[Sides]:
        """A new sandbox."""
        limit = self._assignment.fields.limits.test_s
        self.output = ""
        with contextlib.ExitStack() as stack:

            def start(submission: Submission) -> SandboxSession:
                session = SandboxSession(submission, self._assignment.policy, accept_weak=self._accept_weak)
                return stack.enter_context(session)

            session = start(self._submission)
            self.level, self.proofs = session.level, dict(session.proofs)
            entry = self._assignment.fields.entry
            reference = Submission(entry, "file", {entry: self._assignment.solution_source.encode()}, entry)
            try:
                yield (
                    SandboxedImplementation(session, limit),
                    lambda: SandboxedImplementation(start(reference), limit),
                )
            finally:
                self.output = session.output[-_OUTPUT_KEPT:]


@dataclass
class Grading:
    """The tests of one assignment for one student."""

    assignment: Assignment
    student: str
    secret: bytes
    _replays: dict[tuple[str, str], list[Remembered]] = field(default_factory=dict, repr=False)
    _asked: list[tuple[TestSpec, Remembering]] = field(default_factory=list, repr=False)
    """What the submission under way answered in the tests up to now."""

    def refused(self, reason: str) -> GradeOutcome:
        """The outcome of a submission that cannot be run: no points, and why."""
        tests = tuple(
            self._outcome(number, spec, "failed", 0.0, f"Not run: {reason}", "", 0.0)
            for number, spec in enumerate(self.assignment.tests, start=1)
        )
        return replace(self._start(), complete=True, tests=tests, notes=(reason,))

    def run(self, submission: Runner, keep: Callable[[GradeOutcome], None]) -> GradeOutcome:
        """Every test in turn; ``keep`` gets the outcome after each."""
        outcome = self._start()
        for outcome in self.outcomes(submission):
            keep(outcome)
        return outcome

    def outcomes(self, submission: Runner) -> Iterator[GradeOutcome]:
        """The outcome after each test."""
        started = time.monotonic()
        outcome = replace(self._start(), submission_digest=submission.digest, notes=submission.notes)
        shares: dict[str, float] = {}
        self._asked.clear()
        for number, spec in enumerate(self.assignment.tests, start=1):
            test, verdict = self._test(number, spec, submission, shares)
            shares[spec.fields.name] = test.score / test.max_score
            # Everybody reads the leaderboard: a value of a hidden test would tell how that one went.
            visible = spec.fields.visibility == "visible"
            rank = verdict.leaderboard if verdict is not None and visible else ()
            outcome = replace(
                outcome,
                complete=number == len(self.assignment.tests),
                tests=(*outcome.tests, test),
                sandbox_level=submission.level,
                proofs=submission.proofs,
                seconds=time.monotonic() - started,
                leaderboard=(*outcome.leaderboard, *rank),
            )
            yield outcome

    def _test(
        self, number: int, spec: TestSpec, submission: Runner, shares: Mapping[str, float]
    ) -> tuple[TestOutcome, Verdict | None]:
        after = spec.fields.after
        if after is not None and shares[after] < 0.5:
            message = f"Run once the test {after!r} has earned half of its points."
            return self._outcome(number, spec, "skipped", 0.0, message, "", 0.0), None
        started = time.monotonic()
        verdict: Verdict | None = None
        status: TestStatus = "failed"
        credit, detail = 0.0, ""
        remembering: Remembering | None = None
        try:
            with submission.open() as (implementation, reference_side):
                remembering = Remembering(implementation)
                self._asked.append((spec, remembering))
                trial = self.trial(spec, remembering, reference_side, submission.missing)
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
        if status in ("failed", "partial") and remembering is not None:
            causes: list[str] = []
            try:
                causes = self.causes(spec, remembering)
            except Exception as error:
                # Without an explanation the marks still stand.
                detail += "".join(traceback.format_exception(error))
            hint = [spec.fields.hint] if spec.fields.hint and not causes else []
            message = "\n".join([*causes, message, *hint])
        if submission.output:
            detail += f"\nprinted:\n{submission.output}"
        seconds = time.monotonic() - started
        plots = verdict.plots if verdict is not None else ()
        test = self._outcome(number, spec, status, credit, message, detail.strip(), seconds)
        return replace(test, plots=plots), verdict

    def trial(
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
            reference=TrustedImplementation(self.assignment.solution()),
            cases=self.assignment.cases,
            seeded=lambda: hidden_generator(
                self.secret, self.assignment.name, self.student, spec.fields.name
            ),
            sandboxed_reference=reference_side,
            missing=missing,
            short=short,
        )

    def causes(self, spec: TestSpec, answered: Remembering) -> list[str]:
        """Why the answers are wrong, as far as the known mistakes tell.

        A mistake that earlier tests speak against (it would have spoilt an answer that was right) is none.
        """
        asked = functions_asked(answered.answers)
        known = (
            (mutant.message, self._replay(spec, mutant))
            for mutant in self.assignment.mutants
            if mutant.touches(asked) and not self._spoken_against(mutant, spec)
        )
        return explain(answered.answers, self._replay(spec, None), known)

    def _spoken_against(self, mutant: Mutant, spec: TestSpec) -> bool:
        return any(
            contradicted(self._replay(earlier, mutant), answered.answers, self._replay(earlier, None))
            for earlier, answered in self._asked
            if earlier is not spec and earlier.fields.kind in _SINGLE_CALLS
            if mutant.touches(functions_asked(answered.answers))
        )

    def _replay(self, spec: TestSpec, mutant: Mutant | None) -> list[Remembered]:
        """What the reference, or the reference with a mistake, answers in a test; run once."""
        key = spec.fields.name, mutant.name if mutant else ""
        if key not in self._replays:
            module = self.assignment.mutated(mutant) if mutant else self.assignment.solution()
            remembering = Remembering(TrustedImplementation(module))
            # A mutant may fail in any way that a submission may; what it answered before that counts, and
            # its warnings are nobody's.
            with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"):
                spec.plugin.target(self.trial(spec, remembering, short=True), **spec.parameters)
            self._replays[key] = remembering.answers
        return self._replays[key]

    def _outcome(
        self,
        number: int,
        spec: TestSpec,
        status: TestStatus,
        credit: float,
        message: str,
        detail: str,
        seconds: float,
    ) -> TestOutcome:
        fields = spec.fields
        return TestOutcome(
            number=str(number),
            name=fields.name,
            kind=fields.kind,
            status=status,
            score=credit * fields.points,
            max_score=fields.points,
            visibility=fields.visibility,
            message=message,
            staff_detail=detail,
            seconds=seconds,
        )

    def _start(self) -> GradeOutcome:
        return GradeOutcome(
            assignment=self.assignment.name,
            assignment_digest=self.assignment.digest,
            student=self.student,
            submission_digest="",
            complete=False,
            tests=(),
            sandbox_level="not started",
            proofs={},
            seconds=0.0,
            versions={
                "python": platform.python_version(),
                "slamcmp": slamcmp.__version__,
                **{name: importlib.metadata.version(name) for name in ("numpy", "scipy")},
            },
        )


def _raised(error: StudentError) -> str:
    if error.type_name == "NotImplementedError":
        where = f" ({error.frames[-1].function})" if error.frames else ""
        return f"Not implemented yet{where}."
    return error.text
