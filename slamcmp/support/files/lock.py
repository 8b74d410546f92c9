"""One writer a folder: a lock that goes with the process that holds it."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from slamcmp.errors import UsageError
from slamcmp.support.files.atomic import storage_error


@contextlib.contextmanager
def locked(folder: Path, *, who: str = "run", instead: str = "--results") -> Iterator[None]:
    """Hold the folder, which is made where it is not there; ``.lock`` in it names the process.

    Args:
        folder: to be written to.
        who: writes there, as a message names it.
        instead: the option that names another folder.

    Raises:
        UsageError: another process holds it.
        StorageError: the folder cannot be written.
    """
    path = folder / ".lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise storage_error(path, error) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(descriptor, 20).decode(errors="replace") or "unknown"
            raise UsageError(
                f"{folder}: another {who} is writing here (process {holder}); wait for it, or give this one "
                f"another folder with {instead}"
            ) from error
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
        yield
    finally:
        os.close(descriptor)
