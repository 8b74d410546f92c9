"""The body of a worker process: its log, its limits, and its end with all that it started."""

from __future__ import annotations

import contextlib
import errno
import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator, MutableSequence
from multiprocessing import util
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from slamcmp.experiment.job.task import Task
from slamcmp.support.process_tree import end_children, lead_group
from slamcmp.support.shared_arrays import SharedArrays

OF_A_PROCESS = frozenset({errno.EBADF, errno.EMFILE, errno.ENFILE, errno.ENOMEM})
"""Errors of descriptors and limits that a process, or the plug-in in it, has set itself."""
OUTDATED, LOST_STREAM, STORAGE_FAILED = 1, 2, 3
"""Why there is no result, if it is not the back end's doing."""


def work(tasks: Connection, heartbeat: MutableSequence[float], shared: SharedArrays, temporary: Path) -> None:
    """Do the jobs that come through the connection, and end this process.

    It says True there after each job that left it as good as new; after any other one it is gone.
    """
    # Ctrl-C reaches the whole process group; the parent decides what ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lead_group()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    _use_temporary_folder(temporary)
    code = 0
    with contextlib.suppress(EOFError, OSError):
        while code == 0:
            task: Task = tasks.recv()
            code, as_good_as_new = _do(task, heartbeat, shared)
            if not (as_good_as_new and task.shares_process):
                break
            shared.clear()
            tasks.send(True)
    with contextlib.suppress(Exception):
        end_children()
    getattr(util, "_run_finalizers", lambda _: None)(0)
    # At once: a thread that was left behind has nobody to work for.
    os._exit(code)


def _do(task: Task, heartbeat: MutableSequence[float], shared: SharedArrays) -> tuple[int, bool]:
    """One job: the exit code that it asks for, and whether this process is as good as new after it."""
    from slamcmp.errors import StorageError
    from slamcmp.experiment.job.planned import OutdatedError
    from slamcmp.experiment.job.worker import LostStreamError, perform
    from slamcmp.support.memory import limit_growth

    with _output_to_log(task):
        if task.memory_limit_mb is not None:
            limit_growth(task.memory_limit_mb)
        try:
            return 0, perform(task, heartbeat, shared if task.kind == "run" else None)
        except OutdatedError as error:
            heartbeat[4] = OUTDATED
            print(f"not what was planned: {error}", file=sys.stderr)
        except LostStreamError:
            heartbeat[4] = LOST_STREAM
            traceback.print_exc()
        except (StorageError, OSError) as error:
            if not _is_of_this_process(error):
                heartbeat[4] = STORAGE_FAILED
            with contextlib.suppress(OSError):
                print(error, file=sys.stderr)
        except BaseException:
            # Here, while standard error still leads to the log, unless the plug-in closed it.
            with contextlib.suppress(OSError):
                traceback.print_exc()
    return 1, False


def _is_of_this_process(error: BaseException) -> bool:
    """Whether the disk has no part in it: a plug-in closed or used up its process's files."""
    causes = (error, error.__cause__)
    return any(isinstance(each, OSError) and each.errno in OF_A_PROCESS for each in causes)


def _follow(parent: Any) -> None:
    """A worker whose parent died has nobody to work for."""
    parent.join()
    with contextlib.suppress(Exception):
        end_children()
    os._exit(1)


def _use_temporary_folder(folder: Path) -> None:
    """What is left there goes with the worker."""
    with contextlib.suppress(OSError):
        folder.mkdir(exist_ok=True)
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder)


@contextlib.contextmanager
def _output_to_log(task: Task) -> Iterator[None]:
    """What a back end prints would tear the progress bar; it goes to logs/KEY.log, if there is any."""
    path = task.log
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Appending: the parent may shorten the file meanwhile.
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND
        descriptor = os.open(path, flags, 0o666)
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
