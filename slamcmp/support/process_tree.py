"""End a process with all that it started, also what went out of its group or lost its parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36


def lead_group() -> None:
    """Make this process the one that its descendants fall back to: where one's parent ends, it is ours."""
    with contextlib.suppress(OSError):
        os.setsid()
    # Only Linux has it; elsewhere a daemon that leaves the group is lost.
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_children() -> None:
    """End every descendant of this process."""
    for _ in range(8):
        try:
            os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        for pid in descendants(os.getpid()):
            _kill(pid)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def end_tree(pid: int) -> None:
    """End a process that leads a group, its group and every descendant."""
    found = descendants(pid)
    for each in (pid, *found):
        _kill(each)
    # Whoever was started meanwhile is in the group, or a descendant of one that now is gone.
    end_group(pid)


def end_group(pid: int) -> None:
    """End what is left of the group that a process led."""
    with contextlib.suppress(OSError):
        os.killpg(pid, signal.SIGKILL)


def is_alive(pid: int) -> bool:
    """Whether there is such a process, of whichever user."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def descendants(pid: int) -> list[int]:
    """Children, their children and so on; none where the system does not tell."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            # The name in brackets may hold anything, brackets too.
            parent = int((folder / "stat").read_text(errors="replace").rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(folder.name))
    found: list[int] = []
    waiting = [pid]
    while waiting:
        for child in children.get(waiting.pop(), []):
            found.append(child)
            waiting.append(child)
    return found


def _kill(pid: int) -> None:
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGKILL)
