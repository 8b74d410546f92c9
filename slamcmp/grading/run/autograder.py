"""Inside of a platform's container: grade the one submission that lies there, and always leave a result.

The result is written again after each test, and the grading ends before the platform would end it. So a
crash, an endless submission or a slow machine cost the tests that were not reached, and nothing else.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slamcmp.errors import DataError, SlamcmpError
from slamcmp.grading.results.gradescope import write_gradescope_results
from slamcmp.grading.results.outcome import GradeOutcome, load_outcome
from slamcmp.grading.results.prairielearn import write_prairielearn_results
from slamcmp.grading.results.student_view import STATUS_WORDS, clean, points, total
from slamcmp.grading.run.grade_process import (
    GRADER,
    Ended,
    GradeProcess,
    GradeRequest,
    outcome_of,
    with_unreached,
)
from slamcmp.grading.sandbox.staging import own_prefix
from slamcmp.support.messages import printable

Writer = Callable[[GradeOutcome, Path], None]
POLL_S = 0.1
SOLUTION = "solution"
"""The folder of an assignment that holds the reference's files."""


@dataclass(frozen=True)
class Settings:
    """``settings.json`` beside the assignment."""

    assignment: str
    time_limit_s: float
    accept_weak_sandbox: bool


@dataclass(frozen=True)
class Layout:
    """Where a platform puts things."""

    source: Path
    submission: Path
    results: Path
    metadata: Path | None
    write: Writer


def gradescope_layout() -> Layout:
    """``/autograder``, or what the environment variable ``AUTOGRADER_ROOT`` says."""
    root = Path(os.environ.get("AUTOGRADER_ROOT", "/autograder"))
    return Layout(
        source=root / "source",
        submission=root / "submission",
        results=root / "results" / "results.json",
        metadata=root / "submission_metadata.json",
        write=write_gradescope_results,
    )


def prairielearn_layout() -> Layout:
    """``/grade`` or ``GRADE_ROOT``; the bundle itself is where Gradescope would have it."""
    root = Path(os.environ.get("GRADE_ROOT", "/grade"))
    return Layout(
        source=gradescope_layout().source,
        submission=root / "student",
        results=root / "results" / "results.json",
        metadata=None,
        write=write_prairielearn_results,
    )


def run_autograder(layout: Layout, *, grader: str = GRADER) -> GradeOutcome:
    """Grade what lies in ``layout.submission`` and leave the platform's result file.

    What the staff may see beyond the student goes to standard output.

    Raises:
        DataError: the bundle is not whole.
    """
    settings = _settings(layout.source)
    # Results of earlier submissions are in there, those of hidden tests among them.
    _only_for_us(layout.metadata)
    _only_for_us(layout.source)
    _only_for_us(layout.results.parent)
    request = GradeRequest(
        assignment=str(layout.source / "assignments" / settings.assignment),
        submission=str(_submitted(layout.submission)),
        student=student_of(layout.metadata),
        secret=_secret(layout.source).hex(),
        outcome="",
        accept_weak_sandbox=settings.accept_weak_sandbox,
    )
    outcome, ended, log = _supervise(request, settings.time_limit_s, grader, layout)
    print(staff_text(outcome))
    if ended.ending != "ok":
        print(printable(f"\nThe grading ended early: {ended.ending}: {ended.message}\n{log}"))
    return outcome


def self_test(layout: Layout, *, grader: str = GRADER) -> str:
    """Grade the assignment's own solution; a sentence on how it went.

    Raises:
        DataError: it does not get every point, or the bundle is not whole.
    """
    settings = _settings(layout.source)
    assignment = layout.source / "assignments" / settings.assignment
    request = GradeRequest(
        assignment=str(assignment),
        submission=str(assignment / SOLUTION),
        student="self-test",
        secret=_secret(layout.source).hex(),
        outcome="",
        # An image may be built with less protection than it runs with: that is looked at then.
        accept_weak_sandbox=True,
    )
    outcome, ended, log = _supervise(request, settings.time_limit_s, grader, None)
    earned, possible = total(outcome.tests), total(outcome.tests, of="max_score")
    if ended.ending != "ok" or not outcome.complete or earned < possible or not possible:
        raise DataError(
            f"self-test failed: the solution got {points(earned)} of {points(possible)} points "
            f"({ended.ending} {ended.message})\n{staff_text(outcome)}\n{log}"
        )
    text = f"self-test passed: the solution got {points(earned)} of {points(possible)} points"
    text += f" in {ended.seconds:.1f} s; sandbox level here: {outcome.sandbox_level}"
    if outcome.sandbox_level not in ("strong", "names visible") and not settings.accept_weak_sandbox:
        text += "\nWARNING: with this level submissions are not graded; see docs/grading.md"
    return text


def student_of(metadata: Path | None) -> str:
    """Who the hidden seeds are for: the e-mail addresses of the submission's users, in order.

    ``student`` where the platform does not tell.
    """
    if metadata is None:
        return "student"
    try:
        users = json.loads(metadata.read_text(encoding="utf-8"))["users"]
        names = sorted(str(user.get("email") or user["id"]) for user in users)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "student"
    return "+".join(names) or "student"


def staff_text(outcome: GradeOutcome) -> str:
    """Every test with its message and detail, hidden ones too."""
    possible = points(total(outcome.tests, of="max_score"))
    lines = [
        f"{outcome.student}: {points(total(outcome.tests))} of {possible} points",
        f"sandbox level: {outcome.sandbox_level}",
        *outcome.notes,
    ]
    for test in outcome.tests:
        score = f"{points(test.score)} of {points(test.max_score)}"
        lines += ["", f"{test.number} {test.name} [{test.visibility}]: {STATUS_WORDS[test.status]}, {score}"]
        lines += [part for part in (test.message, test.staff_detail) if part]
    return "\n".join(clean(line) for line in lines)


def main() -> None:
    """``python -m slamcmp.grading.run.autograder gradescope|prairielearn|self-test``."""
    what = sys.argv[1] if len(sys.argv) == 2 else ""
    try:
        if what == "self-test":
            print(self_test(gradescope_layout()))
        elif what in ("gradescope", "prairielearn"):
            run_autograder(gradescope_layout() if what == "gradescope" else prairielearn_layout())
        else:
            sys.exit(main.__doc__)
    except SlamcmpError as error:
        sys.exit(str(error))


def _supervise(
    request: GradeRequest, time_limit_s: float, grader: str, layout: Layout | None
) -> tuple[GradeOutcome, Ended, str]:
    """The outcome, how it ended, and what the grader printed; the result file follows each test."""
    stopped: list[int] = []
    folder = Path(tempfile.mkdtemp(prefix=own_prefix()))
    before = signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    try:
        path, log = folder / "outcome.json", folder / "grader.log"
        request = GradeRequest(**{**vars(request), "outcome": str(path)})
        process = GradeProcess(request, time_limit_s=time_limit_s, log=log, grader=grader)
        seen = 0
        try:
            while (ended := process.poll()) is None and not stopped:
                time.sleep(POLL_S)
                changed = path.stat().st_mtime_ns if path.exists() else 0
                if layout is not None and changed != seen:
                    seen = changed
                    so_far = with_unreached(load_outcome(path), Path(request.assignment))
                    layout.write(so_far, layout.results)
        finally:
            process.kill()
        if ended is None:
            ended = Ended("timed_out", "the platform asked to stop", time_limit_s)
        outcome = outcome_of(request, ended)
        if layout is not None:
            layout.write(outcome, layout.results)
        return outcome, ended, log.read_text(errors="replace")[-20_000:] if log.exists() else ""
    finally:
        signal.signal(signal.SIGTERM, before)
        shutil.rmtree(folder, ignore_errors=True)


def _settings(source: Path) -> Settings:
    path = source / "settings.json"
    try:
        content: dict[str, Any] = json.loads(path.read_text())
        return Settings(**content)
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"{path}: cannot be used ({error}); make the bundle again") from error


def _secret(source: Path) -> bytes:
    path = source / "secret"
    try:
        return path.read_bytes().strip()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); make the bundle again") from error


def _submitted(folder: Path) -> Path:
    """A platform puts a single file into a folder, where a notebook would not be looked for."""
    with contextlib.suppress(OSError):
        entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
        if len(entries) == 1 and entries[0].is_file() and not entries[0].is_symlink():
            return entries[0]
    return folder


def _only_for_us(path: Path | None) -> None:
    if path is not None:
        # Where we are not the owner, the sandbox alone stands before it.
        with contextlib.suppress(OSError):
            path.chmod(path.stat().st_mode & ~0o077)


if __name__ == "__main__":
    main()
