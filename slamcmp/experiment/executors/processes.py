"""Where jobs run: in worker processes, or all in this one.

A worker that crashes, hangs or is killed takes its own job with it and nothing else. Jobs of our own
plug-ins follow one another in a process, those of one stream in one that has it at hand; a user's has
a process to itself, and so has whatever comes after a job that did not end well.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Collection
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from slamcmp.errors import SlamcmpError, StorageError
from slamcmp.experiment.executors.fork_server import no_main_module, refresh, warm_up
from slamcmp.experiment.job.process import LOST_STREAM, OUTDATED, STORAGE_FAILED, work
from slamcmp.experiment.job.task import BEATS
from slamcmp.registry import executors
from slamcmp.support.files.log_file import trim
from slamcmp.support.messages import describe
from slamcmp.support.process_tree import end_group, end_tree, is_alive
from slamcmp.support.shared_arrays import SharedArrays
from slamcmp.types import Status

if TYPE_CHECKING:
    from slamcmp.experiment.job.task import Task

GRACE_S = 2.0
"""Past its time limit a back end may finish the frame it is in; then the parent ends it."""
LOOK_EVERY_S = 0.1
"""How often a job is looked at that nobody waits for with others."""
LOADING_S = 120.0
"""A job may take that long, beside its limit, to read its stream and load its plug-in."""
OWN_FAULTS = frozenset(
    getattr(signal, name)
    for name in ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSYS", "SIGTRAP")
    if hasattr(signal, name)
)
"""Signals that a process brings upon itself; any other comes from outside."""
TEMPORARY = "slamcmp-"


class ExecutorLostError(SlamcmpError):
    """Where jobs ran does not answer any more; results that came back are kept."""


@dataclass(frozen=True)
class Ended:
    """How a job came to its end."""

    task: Task
    fault: str = ""
    """Why there is no result file; empty where there is one."""
    status: Status = "crashed"
    """Of a job with a fault; ``missing`` where it has to be run again, whatever its back end does."""
    outdated: bool = False
    """The worker had loaded or read something else than what was planned."""
    storage_failed: bool = False
    frames_done: int = 0
    note: str = ""
    """What happened after the result file was written."""
    shared: SharedArrays | None = None
    """What a run had done; to be closed by who gets this."""
    not_begun: bool = False
    """A worker that had done other jobs before was gone when this one came to it."""


class Executor(Protocol):
    """Runs jobs; constructed as ``Name(*, slots)``."""

    slots: int
    """How many jobs may run at a time."""

    def start(self, task: Task) -> None:
        """Begin a job; at most ``slots`` at a time."""

    def wait(self, timeout_s: float) -> list[Ended]:
        """The jobs that ended, at latest after the timeout."""

    def frames_done(self) -> dict[str, int]:
        """Frames that each running job has done, by its key."""

    def at_hand(self) -> Collection[str]:
        """Keys of the streams whose runs would begin at once now: a worker without a job holds them."""

    def close(self) -> None:
        """End what still runs."""


@executors.register("processes")
class Processes:
    """Worker processes, forked from a server that has the heavy modules loaded."""

    def __init__(self, *, slots: int = 1) -> None:
        self.slots = slots
        self._running: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._started = 0
        self._temporary: Path | None = None
        refresh()

    def start(self, task: Task) -> None:
        while (worker := self._idle_worker(task)) is not None:
            if worker.begin(task):
                self._running.append(worker)
                return
        self._start_afresh(task)

    def _start_afresh(self, task: Task) -> None:
        while self._idle and len(self._running) + len(self._idle) >= self.slots:
            self._idle.pop(0).end()
        warm_up()
        self._started += 1
        self._running.append(_Worker(task, self._temporary_folder() / str(self._started)))

    def _idle_worker(self, task: Task) -> _Worker | None:
        """One that can do the job, of several the one that has its stream at hand."""
        if not task.shares_process or not self._idle:
            return None
        wanted = [index for index, worker in enumerate(self._idle) if worker.stream_key == task.stream_key]
        return self._idle.pop(wanted[0] if wanted else 0)

    def wait(self, timeout_s: float) -> list[Ended]:
        connection.wait([each for worker in self._running for each in worker.signs()], timeout_s)
        looked = [(worker, worker.look()) for worker in self._running]
        self._running = [worker for worker, how in looked if how is None]
        self._idle += [worker for worker, how in looked if how is not None and not worker.over]
        for _, how in looked:
            if how is not None and how.not_begun:
                # Somebody ended a worker between two jobs: the second one has nothing to do with it.
                self._start_afresh(how.task)
        return [how for _, how in looked if how is not None and not how.not_begun]

    def frames_done(self) -> dict[str, int]:
        return {worker.task.key: int(worker.heartbeat[1]) for worker in self._running}

    def at_hand(self) -> Collection[str]:
        return {worker.stream_key for worker in self._idle}

    def close(self) -> None:
        for worker in [*self._running, *self._idle]:
            worker.end()
        self._running, self._idle = [], []
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)
            self._temporary = None

    def _temporary_folder(self) -> Path:
        """Of all workers; each has its own in it, which goes with it."""
        if self._temporary is None or not self._temporary.is_dir():
            _remove_left_behind()
            try:
                self._temporary = Path(tempfile.mkdtemp(prefix=f"{TEMPORARY}{os.getpid()}-"))
            except OSError as error:
                raise StorageError(f"no temporary folder can be made: {error}") from error
        return self._temporary


@executors.register("serial", in_process=True)
class Serial:
    """Every job in this process, one after the other: for debuggers and ``print``.

    A crash of the interpreter ends everything, and a time limit is only looked at between frames.
    """

    def __init__(self, *, slots: int = 1) -> None:
        del slots
        self.slots = 1
        self._ended: list[Ended] = []

    def start(self, task: Task) -> None:
        from slamcmp.experiment.job.planned import OutdatedError
        from slamcmp.experiment.job.worker import LostStreamError, perform

        heartbeat = [0.0] * BEATS
        fault = ""
        status: Status = "crashed"
        outdated = False
        try:
            perform(task, heartbeat)
        except OutdatedError:
            fault, status, outdated = "its code or data changed", "missing", True
        except LostStreamError as error:
            fault, status = str(error), "missing"
        except (SlamcmpError, OSError):
            raise
        except Exception as error:
            traceback.print_exc()
            fault = describe(error)
        self._ended.append(Ended(task, fault, status, outdated, frames_done=int(heartbeat[1])))

    def wait(self, timeout_s: float) -> list[Ended]:
        del timeout_s
        ended, self._ended = self._ended, []
        return ended

    def frames_done(self) -> dict[str, int]:
        return {}

    def at_hand(self) -> Collection[str]:
        return ()

    def close(self) -> None:
        self._ended = []


class _Worker:
    """The parent's view of one worker process, and of the job that it does."""

    def __init__(self, task: Task, temporary: Path) -> None:
        context = multiprocessing.get_context("forkserver")
        self.heartbeat: Any = context.RawArray("d", BEATS)
        self._shared = SharedArrays()
        self._temporary = temporary
        self._tasks, tasks = context.Pipe()
        self._hung_up = False
        self._jobs = 0
        self.process = context.Process(
            target=work, args=(tasks, self.heartbeat, self._shared, temporary), daemon=True
        )
        self.over = False
        try:
            with no_main_module():
                self.process.start()
        except BaseException:
            self._let_go()
            self._shared.close()
            raise
        finally:
            tasks.close()
        self._pid = self.process.pid or 0
        self.begin(task)

    def begin(self, task: Task) -> bool:
        """Hand it a job; False where it is gone, which of a first one :meth:`look` tells."""
        self.task = task
        self._result_seen: float | None = None
        self._begin = time.monotonic()
        self._jobs += 1
        self.heartbeat[:] = [0.0] * BEATS
        try:
            self._tasks.send(task)
        except OSError:
            self._hung_up = True
            if self._jobs > 1:
                self.end()
            return False
        return True

    @property
    def stream_key(self) -> str:
        """Of the stream that it has at hand."""
        return self.task.key if self.task.kind == "stream" else self.task.stream_key

    def signs(self) -> list[Any]:
        """What to wait for."""
        return [self.process.sentinel, *([] if self._hung_up else [self._tasks])]

    def look(self) -> Ended | None:
        """How the job ended, or None while it runs; ends it where its time is over."""
        trim(self._log)
        late = ""
        if self._is_done():
            return self._done()
        if self.process.exitcode is None:
            late = self._late()
            if not late and not self._lingers():
                return None
            end_tree(self._pid)
            self.process.join()
            return self._ended(late, by_us=True)
        return self._ended(late, by_us=False)

    def end(self) -> None:
        """End it, whatever it does."""
        end_tree(self._pid)
        self.process.join()
        self._let_go()
        self._shared.close()

    def _is_done(self) -> bool:
        """Whether it says that it did its job and can do another."""
        if self._hung_up:
            return False
        try:
            return self._tasks.poll() and bool(self._tasks.recv())
        except (EOFError, OSError):
            self._hung_up = True
            return False

    def _done(self) -> Ended:
        frames = int(self.heartbeat[1])
        if self.task.result.is_file():
            return Ended(self.task, frames_done=frames)
        return Ended(self.task, "the worker process did its job and left no result", frames_done=frames)

    def _late(self) -> str:
        """Why it has to be ended, or nothing while it is within its limits.

        They count estimation: what loads, scores and saves is ours.
        """
        started, _, frames_done_at, answered_at, _ = self.heartbeat
        limit = self.task.time_limit_s + GRACE_S
        now = time.monotonic()
        if answered_at:
            return ""
        if not started:
            return "" if now < self._begin + limit + LOADING_S else "it did not come to its start"
        if now < (frames_done_at or started) + limit:
            return ""
        if frames_done_at:
            return f"what it is asked after the last frame took longer than {limit:g} s"
        return f"ended {limit:g} s after its start: it was stuck"

    def _lingers(self) -> bool:
        """Whether everything is written and the process does not end all the same."""
        if not self.heartbeat[3] or not self.task.result.is_file():
            return False
        if self._result_seen is None:
            self._result_seen = time.monotonic()
        return time.monotonic() > self._result_seen + GRACE_S

    def _ended(self, late: str, *, by_us: bool) -> Ended:
        self.over = True
        code, frames, reason = self.process.exitcode, int(self.heartbeat[1]), int(self.heartbeat[4])
        # Its children end with it, however it ended.
        end_group(self._pid)
        lost_server = code == 255 and is_alive(self._pid)
        if lost_server:
            end_tree(self._pid)
        self.process.close()
        self._let_go()
        trim(self._log)
        if self.task.result.is_file():
            # The file is put in place as a whole and as the last thing: how the process ended then is a note.
            note = f"afterwards {_death(code)}" if code and not by_us else ""
            self._shared.close()
            return Ended(self.task, frames_done=frames, note=note)
        fault, status = f"{_death(code)} and left no result", _status_of(code)
        if late:
            fault, status = late, "timed_out"
        elif reason in (OUTDATED, LOST_STREAM):
            status = "missing"
        elif lost_server:
            fault, status = "the server of the worker processes was killed", "killed"
        not_begun = self._jobs > 1 and not self.heartbeat[0] and status == "killed" and not lost_server
        if self.task.kind == "stream" or not_begun:
            self._shared.close()
        return Ended(
            self.task,
            fault,
            status,
            outdated=reason == OUTDATED,
            storage_failed=reason == STORAGE_FAILED and not late,
            frames_done=frames,
            shared=self._shared if self.task.kind == "run" and not not_begun else None,
            not_begun=not_begun,
        )

    @property
    def _log(self) -> Path:
        return self.task.log

    def _let_go(self) -> None:
        self._tasks.close()
        shutil.rmtree(self._temporary, ignore_errors=True)


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            hint = " (the system may have been out of memory)" if name == "SIGKILL" else ""
            return f"the worker process was killed by {name}{hint}"
    return f"the worker process ended with exit code {code}"


def _status_of(code: int | None) -> Status:
    return "killed" if code is not None and code < 0 and -code not in OWN_FAULTS else "crashed"


def _remove_left_behind() -> None:
    """The temporary folders of runs that were killed themselves."""
    for folder in Path(tempfile.gettempdir()).glob(f"{TEMPORARY}[0-9]*-*"):
        pid = folder.name.removeprefix(TEMPORARY).partition("-")[0]
        if pid.isdigit() and not is_alive(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)
