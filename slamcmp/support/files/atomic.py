"""Write files so that a reader or an interruption never meets half of one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from slamcmp.errors import StorageError
from slamcmp.support.process_tree import is_alive


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Call ``write(file)`` on a temporary neighbour of ``path``, then rename it to ``path``.

    Raises:
        StorageError: the disk is full or the folder is not writable; an older ``path`` is untouched.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            write(file)
        temporary.replace(path)
    except OSError as error:
        raise storage_error(path, error) from error
    finally:
        # Below something that is no folder there is nothing to remove.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_left_behind(*folders: Path) -> None:
    """Remove the temporary files of writers that were killed; only for who holds the folders' lock."""
    for folder in folders:
        for path in folder.glob(".*.[0-9]*"):
            name, _, pid = path.name.rpartition(".")
            if pid.isdigit() and "." in name[1:] and not is_alive(int(pid)):
                with contextlib.suppress(OSError):
                    path.unlink()


def storage_error(path: Path, error: OSError) -> StorageError:
    """The one message for a full disk or a folder that cannot be written."""
    return StorageError(
        f"cannot write {path}: {error.strerror or error}; what finished before is kept: "
        "make room (or name another folder with --results) and run the same command again"
    )
