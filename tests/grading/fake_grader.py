"""A grader for the tests of what happens around one: three tests in a real sandbox, one of them hidden.

A submission that holds a line ``# the grader NAME`` makes the grader itself do what ``_FAULTS`` says.
"""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

from slamcmp.grading.hand_in.hand_in import SubmissionError
from slamcmp.grading.hand_in.submission import Submission, load_submission
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, TestStatus, Visibility, save_outcome
from slamcmp.grading.sandbox.errors import (
    SandboxError,
    SandboxUnavailable,
    StudentCrashed,
    StudentTimeout,
)
from slamcmp.grading.sandbox.policy import Policy
from slamcmp.grading.sandbox.session import SandboxSession

POLICY = Policy(packages=("numpy",), memory_bytes=512 << 20, load_s=2.0, request_s=2.0, output_bytes=1 << 12)
TESTS: tuple[tuple[str, str, float, float, Visibility], ...] = (
    ("1", "double", 3.0, 6.0, "visible"),
    ("2", "half", 3.0, 1.5, "visible"),
    ("3", "square", 3.0, 9.0, "hidden"),
)


def _raise(assignment: Path, submission: Path) -> None:
    raise RuntimeError("a fault in the grader")


def _unavailable(assignment: Path, submission: Path) -> None:
    raise SandboxUnavailable("this machine protects nothing")


def _append(file: Path) -> None:
    file.write_text(f"{file.read_text()}\n# another line\n")


_FAULTS: dict[str, Callable[[Path, Path], object]] = {
    "raises": _raise,
    "crashes": lambda *_: os.kill(os.getpid(), signal.SIGSEGV),
    "hangs": lambda *_: time.sleep(600),
    "refuses": _unavailable,
    "leaves": lambda *_: os._exit(0),
    # Whoever edits these files while a class is graded.
    "sees_another_assignment": lambda assignment, _: _append(assignment / "assignment.yaml"),
    "sees_another_submission": lambda _, submission: _append(submission),
}


def grade(
    assignment: Path,
    submission: Path,
    *,
    student: str,
    secret: bytes,
    out: Path | None,
    accept_weak_sandbox: bool = False,
) -> GradeOutcome:
    """Points for each of :data:`TESTS`, 10 each; a fault comes after the first of them."""
    tests: list[TestOutcome] = []
    notes: tuple[str, ...] = ()
    loaded: Submission | None = None
    level = "unknown"
    began = time.monotonic()
    try:
        loaded = load_submission(submission)
    except SubmissionError as error:
        notes = (str(error),)

    def outcome(complete: bool) -> GradeOutcome:
        return GradeOutcome(
            assignment=assignment.name,
            assignment_digest="",
            student=student,
            submission_digest="" if loaded is None else loaded.digest,
            complete=complete,
            tests=tuple(tests),
            sandbox_level=level,
            proofs={},
            seconds=time.monotonic() - began,
            versions={},
            notes=notes,
        )

    for number, name, given, expected, visibility in TESTS:
        status: TestStatus = "failed"
        message = "there is no submission to test"
        if loaded is not None:
            status, message, level = _try(loaded, name, given, expected, accept_weak_sandbox)
        score = 10.0 if status == "passed" else 0.0
        detail = f"STAFF-DETAIL secret {secret.hex()}, largest {_largest_kib()} KiB"
        tests.append(TestOutcome(number, name, "unit", status, score, 10.0, visibility, message, detail, 0.1))
        if out is not None:
            save_outcome(outcome(False), out)
        text = "" if loaded is None else loaded.files[loaded.entry].decode()
        for fault in re.findall(r"^# the grader (\w+)", text, re.MULTILINE):
            _FAULTS[fault](assignment, submission)
    return outcome(True)


def _largest_kib() -> int:
    """The most memory that this process ever held."""
    (told,) = re.findall(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(told)


def _try(
    submission: Submission, name: str, given: float, expected: float, accept_weak: bool
) -> tuple[TestStatus, str, str]:
    level = "unknown"
    try:
        with SandboxSession(submission, POLICY, accept_weak=accept_weak) as session:
            level = session.level
            answer = session.call(name, given)
    except StudentTimeout as error:
        return "timed_out", str(error), level
    except StudentCrashed as error:
        return "error", str(error), level
    except SandboxError as error:
        return "failed", str(error), level
    if isinstance(answer, float) and answer == expected:
        return "passed", "", level
    return "failed", f"{name}({given:g}) is {answer!s}, {expected:g} was expected", level
