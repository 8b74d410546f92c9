"""Where jobs run: each in a process of its own, or all in this one.

A worker that crashes, hangs or is killed takes its own job with it and nothing else.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, MutableSequence
from dataclasses import dataclass
from multiprocessing import connection
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

from slamcmp.errors import SlamcmpError
from slamcmp.registry import executors

if TYPE_CHECKING:
    from slamcmp.experiment.job.task import Task

THREAD_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
GRACE_S = 2.0
"""Past its time limit a back end may finish the frame it is in; then the parent ends it."""
STORAGE_FAILED = 74
"""Exit code of a worker that could not write (EX_IOERR)."""


@dataclass(frozen=True)
class Ended:
    """How a job came to its end."""

    task: Task
    fault: str = ""
    """Why there is no result file; empty where there is one."""
    timed_out: bool = False
    storage_failed: bool = False
    frames_done: int = 0
    note: str = ""
    """What happened after the result file was written."""


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

    def close(self) -> None:
        """End what still runs."""


@executors.register("processes")
class Processes:
    """Each job in its own process, forked from a server that has the heavy modules loaded."""

    def __init__(self, *, slots: int = 1) -> None:
        self.slots = slots
        self._running: list[_Worker] = []

    def start(self, task: Task) -> None:
        self._running.append(_Worker(task))

    def wait(self, timeout_s: float) -> list[Ended]:
        connection.wait([worker.process.sentinel for worker in self._running], timeout_s)
        ended = [how for how in (worker.look() for worker in self._running) if how is not None]
        self._running = [worker for worker in self._running if not worker.over]
        return ended

    def frames_done(self) -> dict[str, int]:
        return {worker.task.key: int(worker.heartbeat[1]) for worker in self._running}

    def close(self) -> None:
        for worker in self._running:
            worker.process.kill()
        for worker in self._running:
            worker.process.join()
        self._running = []


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
        from slamcmp.experiment.job.worker import perform
        from slamcmp.support.messages import describe

        heartbeat = [0.0, 0.0, 0.0]
        fault = ""
        try:
            perform(task, heartbeat)
        except (SlamcmpError, OSError):
            raise
        except Exception as error:
            traceback.print_exc()
            fault = describe(error)
        self._ended.append(Ended(task, fault, frames_done=int(heartbeat[1])))

    def wait(self, timeout_s: float) -> list[Ended]:
        del timeout_s
        ended, self._ended = self._ended, []
        return ended

    def frames_done(self) -> dict[str, int]:
        return {}

    def close(self) -> None:
        self._ended = []


def warm_up() -> None:
    """Start the server that workers are forked from; it loads while this process does other things."""
    from multiprocessing import forkserver

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["slamcmp.experiment.job.preload"])
    with _one_thread_each(), _no_main_module():
        forkserver.ensure_running()


class _Worker:
    """The parent's view of one worker process."""

    def __init__(self, task: Task) -> None:
        warm_up()
        context = multiprocessing.get_context("forkserver")
        self.task = task
        self.heartbeat: Any = context.RawArray("d", 3)
        self.process = context.Process(target=_work, args=(task, self.heartbeat), daemon=True)
        self.over = False
        with _no_main_module():
            self.process.start()

    def look(self) -> Ended | None:
        """How the job ended, or None while it runs; ends it where its time is over."""
        started, _, frames_done_at = self.heartbeat
        limit = self.task.time_limit_s + GRACE_S
        late = ""
        if self.process.exitcode is None:
            # The answers after the last frame, their scores and files have a budget of their own.
            since = frames_done_at or started
            if not started or time.monotonic() < since + limit:
                return None
            self.process.kill()
            self.process.join()
            late = (
                f"what it is asked after the last frame, and its scores, took longer than {limit:g} s"
                if frames_done_at
                else f"ended {limit:g} s after its start: it was stuck"
            )
        self.over = True
        code, frames = self.process.exitcode, int(self.heartbeat[1])
        self.process.close()
        if self.task.result.is_file():
            # The file is put in place as a whole and as the last thing: how the process ended then is a note.
            note = f"afterwards {_death(code)}" if code and not late else ""
            return Ended(self.task, frames_done=frames, note=note)
        if late:
            return Ended(self.task, late, timed_out=True, frames_done=frames)
        if code == STORAGE_FAILED:
            return Ended(self.task, "its result could not be written", storage_failed=True)
        return Ended(self.task, f"{_death(code)} and left no result", frames_done=frames)


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            hint = " (the system may have been out of memory)" if name == "SIGKILL" else ""
            return f"the worker process was killed by {name}{hint}"
    return f"the worker process ended with exit code {code}"


def _work(task: Task, heartbeat: MutableSequence[float]) -> None:
    """Body of a worker process."""
    # Ctrl-C reaches the whole process group; the parent decides what ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    from slamcmp.errors import StorageError
    from slamcmp.experiment.job.worker import perform
    from slamcmp.support.memory import limit_growth

    code = 0
    with _output_to_log(task):
        if task.memory_limit_mb is not None:
            limit_growth(task.memory_limit_mb)
        try:
            perform(task, heartbeat)
        except (StorageError, OSError) as error:
            print(error, file=sys.stderr)
            code = STORAGE_FAILED
        except Exception:
            # Here, while standard error still leads to the log.
            traceback.print_exc()
            code = 1
    if code:
        sys.exit(code)


def _follow(parent: Any) -> None:
    """A worker whose parent died has nobody to work for."""
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def _output_to_log(task: Task) -> Iterator[None]:
    """What a back end prints would tear the progress bar; it goes to logs/KEY.log, if there is any."""
    path = task.folder / "logs" / f"{task.key}.log"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
    except OSError:
        descriptor = os.open(os.devnull, os.O_WRONLY)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)
    faulthandler.enable(2)
    try:
        yield
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        with contextlib.suppress(OSError):
            if path.stat().st_size == 0:
                path.unlink()


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Two workers with two BLAS threads each on two cores are many times slower than one."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _no_main_module() -> Iterator[None]:
    """Keep multiprocessing from running the caller's script again in every worker.

    Workers need nothing from it (tasks are plain values, plug-ins are found by name), and a script
    without ``if __name__ == "__main__"`` would start its experiment anew in each of them.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
