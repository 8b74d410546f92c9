"""The server that workers are forked from: it loads the heavy modules once, and anew when they changed."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Iterator
from multiprocessing import forkserver
from pathlib import Path
from types import ModuleType

from slamcmp.backends.filters.loops import is_kept
from slamcmp.errors import StorageError, UsageError
from slamcmp.support.provenance.code_version import PACKAGE, file_digest, version_of

THREAD_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
SOCKET_FOLDER_MAX = 70
"""Bytes of the path of the folder of temporary files: what is added must stay within a socket's 108."""
SHORT_FOLDERS = ("/tmp", "/var/tmp", "/dev/shm")
_loaded_version: str | None = None


def warm_up() -> None:
    """Start the server if it does not run; it loads while this process does other things.

    Raises:
        UsageError: the paths of temporary files are too long for the server's socket.
        StorageError: there is no folder for temporary files.
    """
    global _loaded_version
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["slamcmp.experiment.job.preload"])
    if _loaded_version is None:
        # Before it loads: an edit in between makes it too old, never too new.
        _loaded_version = _package_version()
    with one_thread_each(), no_main_module(), _room_for_sockets():
        forkserver.ensure_running()


def refresh() -> None:
    """End the server if the package's text is not what it loaded; the next job starts another.

    In a notebook the package may be edited between two runs of one process.
    """
    global _loaded_version
    if _loaded_version is not None and _loaded_version != _package_version():
        _loaded_version = None
        server = getattr(forkserver, "_forkserver", None)
        stop = getattr(server, "_stop", None)
        if stop is not None:
            stop()


def _package_version() -> str:
    digests = {}
    for path in PACKAGE.rglob("*.py"):
        # It may be replaced at this moment.
        with contextlib.suppress(OSError):
            digests[str(path)] = file_digest(path)
    # A server that began before anything was compiled has not loaded it, and every job would.
    return f"{version_of(digests)} {is_kept()}"


@contextlib.contextmanager
def one_thread_each() -> Iterator[None]:
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
def no_main_module() -> Iterator[None]:
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


@contextlib.contextmanager
def _room_for_sockets() -> Iterator[None]:
    """A folder for the server's socket whose path is short enough."""
    before = tempfile.tempdir
    try:
        folder = tempfile.gettempdir()
    except OSError as error:
        raise StorageError(f"no folder for temporary files can be written: {error}; set TMPDIR") from error
    if len(os.fsencode(folder)) > SOCKET_FOLDER_MAX:
        short = next((each for each in SHORT_FOLDERS if os.access(each, os.W_OK | os.X_OK)), None)
        if short is None or not Path(short).is_dir():
            raise UsageError(
                f"TMPDIR is too long a path for the sockets of worker processes ({len(os.fsencode(folder))} "
                f"bytes, at most {SOCKET_FOLDER_MAX}): set it to a shorter one"
            )
        tempfile.tempdir = short
    try:
        yield
    finally:
        tempfile.tempdir = before
