"""Tests judged in a process that may die: what an answer does to the grader costs that test only.

The grader forks a child which judges one test after another. An answer that makes it run out of memory,
crash or compute without end ends the child; the test it was at earns nothing and is marked for the staff,
and a new child goes on with the next one. The child says what a test earns before it looks for a cause, so
that a failure in the explanation costs the explanation.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import asdict, replace
from multiprocessing.connection import Connection
from typing import Any, NoReturn, Self

from slamcmp import errors
from slamcmp.errors import SlamcmpError
from slamcmp.grading.assignment.description import LimitFields, TestSpec
from slamcmp.grading.results.outcome import test_of
from slamcmp.grading.run.judge import Judge, Judged, without_points
from slamcmp.grading.sandbox.errors import SandboxUnavailable
from slamcmp.grading.sandbox.staging import remove_of
from slamcmp.grading.sandbox.walls.identity import die_with_parent, hold_undumpable, release_undumpable
from slamcmp.support.messages import printable

_POLL_S = 0.1
_OUT_OF_MEMORY = 71
"""Exit code of a child that ran out of memory."""
_REPLY_BYTES = 64 << 20
_FOR_STUDENT = "The grader could not judge this answer: {why}. The course staff is told."
_RAISED: dict[str, type[SlamcmpError]] = {
    "SandboxUnavailable": SandboxUnavailable,
    **{
        name: kind
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, SlamcmpError)
    },
}
"""What the child may pass on, as the machine's or the assignment's fault: all take one text."""


class Here:
    """In this process."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def judged(self, number: int, spec: TestSpec, shares: Mapping[str, float]) -> Judged:
        """As :meth:`Judge.judged`, with the explanation."""
        judged = self._judge.judged(number, spec, shares)
        return judged if judged.explained else self._judge.explained(judged, spec)


class Apart:
    """In a child of this process, or one after the other in several.

    Args:
        judge: what to do.
        limits: processor time and memory of the child for one test.
    """

    def __init__(self, judge: Judge, limits: LimitFields) -> None:
        self._judge, self._limits = judge, limits
        self._child: _Child | None = None

    def __enter__(self) -> Self:
        # Who waits has the secret too.
        hold_undumpable()
        return self

    def __exit__(self, *_: object) -> None:
        if self._child is not None:
            self._child.end()
        release_undumpable()

    def judged(self, number: int, spec: TestSpec, shares: Mapping[str, float]) -> Judged:
        """As :meth:`Judge.judged`, with the explanation; a test that cannot be judged earns nothing."""
        if self._child is None:
            self._child = _Child(self._judge, self._limits)
        try:
            judged = self._child.first(number, spec, shares)
        except _Died as death:
            self._gone()
            failed = without_points(number, spec, "error", _FOR_STUDENT.format(why=death.why))
            failed = replace(failed, judged=False, staff_detail=f"The grader: {death.detail}")
            return Judged(failed, (), "unknown", {})
        if judged.explained:
            return judged
        try:
            return self._child.second()
        except _Died as death:
            self._gone()
            detail = f"{judged.test.staff_detail}\nThe grader, looking for a cause: {death.detail}"
            return replace(judged, test=replace(judged.test, staff_detail=detail.strip()), explained=True)

    def _gone(self) -> None:
        self._child = None
        self._judge.evidence_lost = True


class _Died(Exception):
    def __init__(self, why: str, detail: str) -> None:
        self.why = why
        """For the student."""
        self.detail = detail
        """For the staff."""
        super().__init__(why)


class _Child:
    def __init__(self, judge: Judge, limits: LimitFields) -> None:
        self._limits = limits
        self._pipe, theirs = multiprocessing.Pipe()
        with warnings.catch_warnings():
            # Other threads of the parent (BLAS has some) are not needed in the child.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._pid = os.fork()
        if self._pid == 0:
            self._pipe.close()
            _serve(judge, theirs, int(limits.grader_mb) << 20)
        theirs.close()

    def first(self, number: int, spec: TestSpec, shares: Mapping[str, float]) -> Judged:
        """What a test earns."""
        self._spec = spec
        with contextlib.suppress(BrokenPipeError):
            self._pipe.send_bytes(json.dumps({"number": number, "shares": dict(shares)}).encode())
        return self._answer()

    def second(self) -> Judged:
        """The same with its explanation."""
        return self._answer()

    def end(self) -> None:
        """Kill it, if it is there, with the sandboxes that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        self._reaped()
        self._pipe.close()

    def _answer(self) -> Judged:
        """The next answer.

        Raises:
            _Died: it does not come.
            SlamcmpError: the child raised it.
        """
        began = self._cpu_s()
        try:
            while not self._pipe.poll(_POLL_S):
                if self._cpu_s() - began > self._limits.grader_s:
                    self.end()
                    limit = f"{self._limits.grader_s:g} s"
                    raise _Died(f"it takes more than {limit} to look at it", f"ended after {limit}")
            told = json.loads(self._pipe.recv_bytes(_REPLY_BYTES))
        except (EOFError, OSError, ValueError) as error:
            raise self._death() from error
        if kind := told.get("raised"):
            raise _RAISED[kind](told["text"])
        return Judged(
            test_of(told["test"]),
            tuple((name, value, end) for name, value, end in told["leaderboard"]),
            told["level"],
            told["proofs"],
            told["explained"],
        )

    def _death(self) -> _Died:
        status = self._reaped()
        self._pipe.close()
        if os.WIFSIGNALED(status):
            name = signal.Signals(os.WTERMSIG(status)).name
            return _Died("it ended the grader's own process", f"killed by {name}")
        if os.WEXITSTATUS(status) == _OUT_OF_MEMORY:
            room = f"{self._limits.grader_mb:g} MB"
            return _Died("it takes more memory than the grader has", f"ran out of its {room}")
        return _Died("it ended the grader's own process", f"exit code {os.WEXITSTATUS(status)}")

    def _reaped(self) -> int:
        try:
            _, status = os.waitpid(self._pid, 0)
        except ChildProcessError:
            status = 0
        # It had no time to remove the folders of its sandboxes.
        remove_of(self._pid)
        return status

    def _cpu_s(self) -> float:
        try:
            # The clock of another process, as clock_getcpuclockid(3) makes its number.
            return time.clock_gettime((~self._pid << 3) | 2)
        except OSError:
            return 0.0


def _serve(judge: Judge, pipe: Connection, room: int) -> NoReturn:
    """Body of the child: judge what is asked for until the pipe is closed."""
    code = 1
    try:
        die_with_parent()
        # The child hides its own memory while it has a sandbox; before, it tries what an open process may do.
        release_undumpable()
        # Ctrl-C in a terminal reaches every process in it; the parent decides.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _limit_memory(room)
        while True:
            _one(judge, pipe)
    except EOFError:
        code = 0
    except MemoryError:
        code = _OUT_OF_MEMORY
    except BaseException as error:
        print(printable("".join(traceback.format_exception(error))), file=sys.stderr, flush=True)
    finally:
        os._exit(code)


def _one(judge: Judge, pipe: Connection) -> None:
    asked = json.loads(pipe.recv_bytes())
    spec = judge.tests[asked["number"] - 1]
    try:
        judged = judge.judged(asked["number"], spec, asked["shares"])
        _tell(pipe, asdict(judged))
        if not judged.explained:
            _tell(pipe, asdict(judge.explained(judged, spec)))
    except SlamcmpError as error:
        kind = type(error).__name__
        _tell(pipe, {"raised": kind if kind in _RAISED else "SlamcmpError", "text": str(error)})


def _tell(pipe: Connection, content: dict[str, Any]) -> None:
    pipe.send_bytes(json.dumps(content).encode())


def _limit_memory(room: int) -> None:
    """Let the process grow by ``room`` bytes from what it has; workers that it starts set their own limit."""
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = used + room
    resource.setrlimit(resource.RLIMIT_AS, (soft if hard == -1 else min(soft, hard), hard))
