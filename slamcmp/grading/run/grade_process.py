"""One grading in a process of its own: whatever becomes of it, its scores so far and the rest survive.

The child leads a process group and asks the kernel to end it with its parent; the sandbox's workers ask the
same of the child. So nothing runs on, whichever of them is killed and however.

The request comes on standard input: arguments and environment of a process can be read by others.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from slamcmp.errors import SlamcmpError
from slamcmp.experiment.executors.fork_server import THREAD_VARIABLES
from slamcmp.grading.results.outcome import GradeOutcome, TestOutcome, load_outcome, save_outcome
from slamcmp.grading.sandbox.staging import own_prefix, remove_stale
from slamcmp.support.messages import printable

Ending = Literal["ok", "crashed", "timed_out", "refused"]

GRADER = "slamcmp.grading.run.grader:grade"
_REFUSED = 69
"""Exit code (EX_UNAVAILABLE) where the machine, not the submission, is the reason."""
_FOR_STUDENTS: dict[Ending, str] = {
    "crashed": "The grader itself stopped before the end.",
    "timed_out": "The grading took longer than the time that the course allows.",
    "refused": "The grader could not work on this machine.",
}


@dataclass(frozen=True)
class GradeRequest:
    """What to grade, and where to write what was found."""

    assignment: str
    submission: str
    student: str
    secret: str
    """Hexadecimal."""
    outcome: str
    """The file that is written again after each test."""
    accept_weak_sandbox: bool = False
    student_page: str = ""
    staff_page: str = ""
    """HTML files to write at the end; empty: none."""


@dataclass(frozen=True)
class Ended:
    """How a grading came to its end."""

    ending: Ending
    message: str
    """For the staff."""
    seconds: float


class GradeProcess:
    """A grading under way; ``poll`` until it has ended."""

    def __init__(
        self, request: GradeRequest, *, time_limit_s: float, log: Path, grader: str = GRADER
    ) -> None:
        self._request = request
        self._limit_s = time_limit_s
        self._log = log
        self._over = False
        self._began = time.monotonic()
        remove_stale()
        self._scratch = Path(tempfile.mkdtemp(prefix=own_prefix()))
        # Other users have to pass through to the submission's own folder, and see no other.
        self._scratch.chmod(0o711)
        environment = {**os.environ, "TMPDIR": str(self._scratch), "PYTHONUNBUFFERED": "1"}
        environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
        log.parent.mkdir(parents=True, exist_ok=True)
        try:
            with log.open("wb") as printed:
                self._process = subprocess.Popen(
                    [
                        sys.executable,
                        "-P",
                        "-m",
                        "slamcmp.grading.run.grade_process",
                        grader,
                        str(os.getpid()),
                    ],
                    stdin=subprocess.PIPE,
                    stdout=printed,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    start_new_session=True,
                )
        except BaseException:
            self._clear()
            raise
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError), self._process.stdin as pipe:
            pipe.write(json.dumps(asdict(request)).encode())

    def poll(self) -> Ended | None:
        """How it ended, or None while it runs; ends it where its time is over."""
        code = self._process.poll()
        seconds = time.monotonic() - self._began
        if code is None:
            if seconds < self._limit_s:
                return None
            self.kill()
            return Ended("timed_out", f"ended after {self._limit_s:g} s", seconds)
        self.kill()
        if code == 0:
            return Ended("ok", "", seconds)
        return Ended("refused" if code == _REFUSED else "crashed", self._last_words(code), seconds)

    def kill(self) -> None:
        """End it and everything that it started; safe to call twice."""
        if self._over:
            return
        self._over = True
        # The group may outlive its leader.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._clear()

    def _clear(self) -> None:
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _last_words(self, code: int) -> str:
        with contextlib.suppress(OSError):
            lines = self._log.read_text(errors="replace").strip().splitlines()
            if lines and code > 0:
                return lines[-1][:500]
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


def outcome_of(request: GradeRequest, ended: Ended) -> GradeOutcome:
    """What was found, also where the grading did not come to its end; in that case the file says so after."""
    path = Path(request.outcome)
    try:
        outcome = load_outcome(path)
    except SlamcmpError:
        outcome = _nothing(request)
    if ended.ending == "ok" and outcome.complete:
        return outcome
    outcome = with_unreached(outcome, Path(request.assignment))
    why = _FOR_STUDENTS.get(ended.ending, _FOR_STUDENTS["crashed"])
    if why not in outcome.notes:
        outcome = replace(outcome, complete=False, notes=(*outcome.notes, why))
        save_outcome(outcome, path)
    return outcome


def with_unreached(outcome: GradeOutcome, assignment: Path) -> GradeOutcome:
    """The outcome with the tests that were not reached, so that a share is one of all points."""
    from slamcmp.grading.assignment.description import load_assignment

    try:
        specs = load_assignment(assignment).tests
    except SlamcmpError:
        return outcome
    unreached = tuple(
        TestOutcome(
            number=str(number),
            name=spec.fields.name,
            kind=spec.fields.kind,
            status="skipped",
            score=0.0,
            max_score=spec.fields.points,
            visibility=spec.fields.visibility,
            message="Not run: the grading had ended before.",
            staff_detail="",
            seconds=0.0,
        )
        for number, spec in enumerate(specs, start=1)
        if number > len(outcome.tests)
    )
    return replace(outcome, tests=outcome.tests + unreached)


def _nothing(request: GradeRequest) -> GradeOutcome:
    return GradeOutcome(
        assignment=Path(request.assignment).name,
        assignment_digest="",
        student=request.student,
        submission_digest="",
        complete=False,
        tests=(),
        sandbox_level="unknown",
        proofs={},
        seconds=0.0,
        versions={},
    )


def main() -> None:
    """Body of the child: grade what standard input says."""
    grader, parent = sys.argv[1:3]
    _follow(int(parent))
    faulthandler.enable()
    # What is raised may quote the submission, and a log is read on a terminal.
    sys.excepthook = lambda _, error, __: print(_traceback(error), file=sys.stderr)
    request = GradeRequest(**json.loads(sys.stdin.buffer.read()))
    from slamcmp.grading.sandbox.errors import SandboxUnavailable

    try:
        outcome = _named(grader)(
            Path(request.assignment),
            Path(request.submission),
            student=request.student,
            secret=bytes.fromhex(request.secret),
            out=Path(request.outcome),
            accept_weak_sandbox=request.accept_weak_sandbox,
        )
    except SandboxUnavailable as error:
        print(error, file=sys.stderr)
        sys.exit(_REFUSED)
    save_outcome(outcome, Path(request.outcome))
    try:
        write_pages(outcome, request)
    except Exception as error:
        # The grade is safe; a page is worth less than a row in the gradebook.
        print(_traceback(error), file=sys.stderr)


def write_pages(outcome: GradeOutcome, request: GradeRequest) -> None:
    """The pages that the request names."""
    from slamcmp.grading.results.page import write_grade_page

    if request.student_page:
        write_grade_page(outcome, Path(request.student_page), audience="student")
    if request.staff_page:
        write_grade_page(outcome, Path(request.staff_page), audience="staff")


def _traceback(error: BaseException) -> str:
    return printable("".join(traceback.format_exception(error)).rstrip())


def _follow(parent: int) -> None:
    from slamcmp.grading.sandbox.walls.identity import die_with_parent

    die_with_parent()
    if os.getppid() != parent:
        os._exit(1)


def _named(grader: str) -> Callable[..., Any]:
    module, _, function = grader.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return found


if __name__ == "__main__":
    main()
