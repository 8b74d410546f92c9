"""Grade one submission: every test in a sandbox of its own, and the outcome written after each."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import slamcmp
from slamcmp.grading.assignment.description import Assignment, find_assignment, load_assignment
from slamcmp.grading.assignment.seeds import check_secret
from slamcmp.grading.hand_in.submission import Submission, SubmissionError, load_submission
from slamcmp.grading.results.outcome import GradeOutcome, save_outcome
from slamcmp.grading.run.implementations import Remembered, SandboxedImplementation
from slamcmp.grading.run.judge import Judge, Runner, Sides, without_points
from slamcmp.grading.run.judging_process import Apart, Here
from slamcmp.grading.run.source_reader import read_source, told
from slamcmp.grading.sandbox.session import SandboxSession
from slamcmp.support.messages import printable

_OUTPUT_KEPT, _HIDDEN_TOLD = 2000, 5


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


class Sandboxed:
    """A submission, to be run in a new sandbox for each test."""

    apart = True

    def __init__(self, assignment: Assignment, submission: Submission, accept_weak: bool) -> None:
        self._assignment = assignment
        self._submission = replace(submission, wanted=tuple(assignment.fields.functions))
        self._accept_weak = accept_weak
        self.digest = submission.digest
        reading = read_source(submission, assignment.fields.functions)
        self.missing = reading.unwritten
        self.notes: tuple[str, ...] = (told(reading.left_out),) if reading.left_out else ()
        if hidden := submission.left_out:
            more = f" and {len(hidden) - _HIDDEN_TOLD} more" if len(hidden) > _HIDDEN_TOLD else ""
            names = printable(", ".join(hidden[:_HIDDEN_TOLD]))
            self.notes += (f"Hidden files are not looked at: {names}{more}.",)
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
    causes: bool = True
    """Whether likely causes are looked for where marks are lost, which takes longest."""
    _replays: dict[tuple[str, str], list[Remembered]] = field(default_factory=dict, repr=False)

    def refused(self, reason: str) -> GradeOutcome:
        """The outcome of a submission that cannot be run: no points, and why."""
        tests = tuple(
            without_points(number, spec, "failed", f"Not run: {reason}")
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
        judge = Judge(
            self.assignment, self.student, self.secret, submission, self._replays, causes=self.causes
        )
        with Apart(judge, self.assignment.fields.limits) if submission.apart else Here(judge) as judging:
            for number, spec in enumerate(self.assignment.tests, start=1):
                judged = judging.judged(number, spec, shares)
                test = judged.test
                shares[spec.fields.name] = test.score / test.max_score
                outcome = replace(
                    outcome,
                    complete=number == len(self.assignment.tests),
                    tests=(*outcome.tests, test),
                    seconds=time.monotonic() - started,
                    leaderboard=(*outcome.leaderboard, *judged.leaderboard),
                )
                if test.judged:
                    outcome = replace(outcome, sandbox_level=judged.level, proofs=judged.proofs)
                yield outcome

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
