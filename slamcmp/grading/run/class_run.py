"""Grade a folder of submissions: side by side, each on its own, going on where an earlier run stopped.

In the results folder: ``gradebook.csv``, written again after each grading, ``summary.json``, ``class.html``
(for the staff), and for each student ``students/NAME-…/`` with ``outcome.json``, ``feedback.html`` (for the
student), ``staff.html``, ``grader.log`` and ``done.json``, which says what the outcome was computed from.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.grading.hand_in.class_folder import (
    Submitted,
    digest_of_folder,
    digest_of_submission,
    find_submissions,
)
from slamcmp.grading.results.class_page import write_class_page
from slamcmp.grading.results.class_summary import ClassSummary, summarise
from slamcmp.grading.results.gradebook import GradebookRow, write_folders, write_gradebook
from slamcmp.grading.results.outcome import load_outcome
from slamcmp.grading.run.class_progress import class_watcher
from slamcmp.grading.run.grade_process import (
    GRADER,
    Ended,
    GradeProcess,
    GradeRequest,
    outcome_of,
    write_pages,
)
from slamcmp.support.cores import available_cores
from slamcmp.support.files.atomic import write_atomically
from slamcmp.support.files.lock import locked
from slamcmp.support.progress import Watcher
from slamcmp.support.provenance.code_version import code_version, versions

FORMAT = 1
POLL_S = 0.02
REFUSALS_MAX = 3
"""So many gradings that the machine refused, and none that worked: the fault is not in the submissions."""


@dataclass(frozen=True)
class ClassResult:
    """What a class run leaves."""

    folder: Path
    rows: tuple[GradebookRow, ...]
    summary: ClassSummary
    graded: int
    reused: int
    interrupted: bool
    left_out: tuple[str, ...] = ()
    """Hidden entries of the class's folder, by their names: not graded."""


@dataclass(frozen=True)
class _Job:
    submitted: Submitted
    content: Mapping[str, Any]
    """All that decides the grade, by digests."""
    key: str
    """sha256 of it."""
    request: GradeRequest
    log: Path


def run_class(
    assignment: Path,
    submissions: Path,
    folder: Path,
    *,
    secret: bytes,
    entry: str | None = None,
    jobs: int | None = None,
    accept_weak_sandbox: bool = False,
    rerun_failed: bool = False,
    time_limit_s: float = 900.0,
    pages: bool = True,
    progress: bool = False,
    grader: str = GRADER,
) -> ClassResult:
    """Grade all of ``submissions`` into ``folder``; what was graded from the same content is kept.

    ``entry`` is the file name that the assignment asks for.

    Ctrl-C and SIGTERM end the gradings under way and leave the rest usable.

    Raises:
        MissingDataError: there is no such folder of submissions.
        UsageError: it is empty, another run writes to ``folder``, or the machine refuses every grading.
        StorageError: a result cannot be written.
    """
    found = find_submissions(submissions, secret)
    submitted = found.submitted
    assignment, folder = assignment.resolve(), folder.resolve()
    with locked(folder, who="class run", instead="--out"), _stop_signals() as stop:
        computed_from = {
            "format": FORMAT,
            "assignment": digest_of_folder(assignment),
            "entry": entry,
            "code": _code(),
            "versions": versions(),
            # Says whether the secret is the same one without telling which.
            "secret": hmac.digest(secret, b"class run", "sha256").hex()[:16],
            "accept_weak_sandbox": accept_weak_sandbox,
            "pages": pages,
        }
        write_folders({each.student: f"students/{each.folder}" for each in submitted}, folder / "folders.csv")
        rows: dict[str, GradebookRow] = {}
        waiting: list[_Job] = []
        for each in submitted:
            job = _job(each, assignment, folder, secret, computed_from, accept_weak_sandbox, pages)
            row = _done_before(job, rerun_failed=rerun_failed)
            if row is None:
                waiting.append(job)
            rows[each.student] = row or _pending(each)
        run = _Run(folder, rows, grader, time_limit_s, stop)
        with class_watcher(len(waiting), show=progress) as watcher:
            run.perform(waiting, jobs or available_cores(), watcher)
        summary = summarise(list(rows.values()))
        text = json.dumps({**summary.as_dict(), "left_out": found.left_out}, indent=1) + "\n"
        write_atomically(folder / "summary.json", lambda file: file.write(text.encode()))
        write_class_page(list(rows.values()), folder / "class.html")
        return ClassResult(
            folder,
            tuple(rows.values()),
            summary,
            run.graded,
            len(submitted) - len(waiting),
            stop.is_set(),
            found.left_out,
        )


class _Run:
    def __init__(
        self,
        folder: Path,
        rows: dict[str, GradebookRow],
        grader: str,
        time_limit_s: float,
        stop: threading.Event,
    ) -> None:
        self._folder, self._rows, self._stop = folder, rows, stop
        self._grader, self._limit_s = grader, time_limit_s
        self._refusals = 0
        self.graded = 0

    def perform(self, waiting: Sequence[_Job], slots: int, watcher: Watcher) -> None:
        """Grade all of it, ``slots`` at a time."""
        left = list(reversed(waiting))
        running: dict[str, tuple[_Job, GradeProcess]] = {}
        self._write_gradebook()
        try:
            while (left or running) and not self._stop.is_set():
                while left and len(running) < slots:
                    job = left.pop()
                    running[job.key] = (job, self._start(job))
                    watcher.started(job.key, job.submitted.student, 0)
                time.sleep(POLL_S)
                for key, (job, process) in list(running.items()):
                    ended = process.poll()
                    if ended is not None:
                        del running[key]
                        self._finish(job, ended)
                        watcher.ended(key, ended.ending, 0)
        finally:
            for _, process in running.values():
                process.kill()

    def _start(self, job: _Job) -> GradeProcess:
        folder = Path(job.request.outcome).parent
        folder.mkdir(parents=True, exist_ok=True)
        # Whatever is found here later is of this grading.
        for name in ("done.json", "outcome.json", "feedback.html", "staff.html"):
            (folder / name).unlink(missing_ok=True)
        return GradeProcess(job.request, time_limit_s=self._limit_s, log=job.log, grader=self._grader)

    def _finish(self, job: _Job, ended: Ended) -> None:
        key = job.key
        if changed := _changed(job):
            # Graded from something else than the key says: it is graded again, whatever the change becomes.
            ended, key = replace(ended, ending="crashed", message=changed), ""
        outcome = outcome_of(job.request, ended)
        if ended.ending == "ok" and not outcome.complete:
            ended = replace(ended, ending="crashed", message="the grader left no whole result")
        if ended.ending != "ok":
            write_pages(outcome, job.request)
        done = {"key": key, "ended": ended.ending, "message": ended.message, "seconds": ended.seconds}
        text = json.dumps(done, indent=1) + "\n"
        path = Path(job.request.outcome).with_name("done.json")
        write_atomically(path, lambda file: file.write(text.encode()))
        entry = job.submitted
        self._rows[entry.student] = GradebookRow(entry.student, entry.path.name, ended.ending, outcome)
        self._write_gradebook()
        self.graded += 1
        if ended.ending == "refused":
            self._refusals += 1
            if self._refusals == self.graded == REFUSALS_MAX:
                raise UsageError(ended.message)

    def _write_gradebook(self) -> None:
        write_gradebook(list(self._rows.values()), self._folder / "gradebook.csv")


def _job(
    entry: Submitted,
    assignment: Path,
    folder: Path,
    secret: bytes,
    computed_from: dict[str, Any],
    accept_weak_sandbox: bool,
    pages: bool,
) -> _Job:
    place = folder / "students" / entry.folder
    content = {
        **computed_from,
        "student": entry.student,
        "submission": digest_of_submission(entry.path, computed_from["entry"]),
    }
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    request = GradeRequest(
        assignment=str(assignment),
        submission=str(entry.path.absolute()),
        student=entry.student,
        secret=secret.hex(),
        outcome=str(place / "outcome.json"),
        accept_weak_sandbox=accept_weak_sandbox,
        student_page=str(place / "feedback.html") if pages else "",
        staff_page=str(place / "staff.html") if pages else "",
    )
    return _Job(entry, content, key, request, place / "grader.log")


def _code() -> str:
    return code_version(sorted(Path(__file__).parents[1].rglob("*.py")))


def _changed(job: _Job) -> str:
    """What a grading was computed from that is not what it was when the class run began; empty: all is."""
    entry, assignment = job.submitted, Path(job.request.assignment)
    now = {
        "slamcmp": ("code", _code),
        "the assignment": ("assignment", lambda: digest_of_folder(assignment)),
        "the submission": ("submission", lambda: digest_of_submission(entry.path, job.content["entry"])),
    }
    for name, (key, digest) in now.items():
        try:
            same = digest() == job.content[key]
        except (OSError, SlamcmpError):
            same = False
        if not same:
            return f"{name} was changed while this was graded; give the same command again"
    return ""


def _done_before(job: _Job, *, rerun_failed: bool) -> GradebookRow | None:
    path = Path(job.request.outcome)
    try:
        done = json.loads(path.with_name("done.json").read_text())
        if done["key"] != job.key or (rerun_failed and done["ended"] != "ok") or done["ended"] == "refused":
            return None
        outcome = load_outcome(path)
    except (OSError, ValueError, KeyError, TypeError, SlamcmpError):
        return None
    return GradebookRow(job.submitted.student, job.submitted.path.name, str(done["ended"]), outcome)


def _pending(entry: Submitted) -> GradebookRow:
    return GradebookRow(entry.student, entry.path.name, "pending", None)


@contextlib.contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C, a closed terminal or SIGTERM sets; gradings under way are worth a clean end."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    wanted = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in wanted}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
