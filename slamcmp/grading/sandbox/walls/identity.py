"""Layer: who the process is. An unused uid, no new privileges, no debugging, no life after the grader."""

from __future__ import annotations

import contextlib
import os
import pwd
import signal
import threading

from slamcmp.grading.sandbox.walls import kernel

# The range that systemd keeps for users made up on the spot; below 65536, so it exists in containers too.
_FIRST_UID, _LAST_UID = 61_184, 65_519
_CLONE_THREAD = 0x00010000
_next_uid = _FIRST_UID + os.getpid() % 4_000
_lock = threading.Lock()


def unused_uid() -> int | None:
    """A uid without account and without processes, another one at each call; None where not root."""
    global _next_uid
    if os.geteuid() != 0:
        return None
    taken = _uids_of_processes() | {entry.pw_uid for entry in pwd.getpwall()}
    with _lock:
        for _ in range(_LAST_UID - _FIRST_UID):
            _next_uid = _next_uid + 1 if _next_uid < _LAST_UID else _FIRST_UID
            if _next_uid not in taken:
                return _next_uid
    return None


def _uids_of_processes() -> set[int]:
    found = set()
    for entry in os.scandir("/proc"):
        # A process may end between being listed and being asked.
        with contextlib.suppress(OSError):
            if entry.name.isdigit():
                found.add(entry.stat().st_uid)
    return found


def become(uid: int) -> None:
    """Give up root for good: all ids, all groups, all capabilities.

    Raises:
        OSError: the process may not change its ids.
    """
    os.setgroups([])
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)


def has_threads() -> bool:
    """Whether this process has more than one thread, those of libraries included."""
    try:
        return len(os.listdir("/proc/self/task")) > 1
    except FileNotFoundError:
        # No /proc in bubblewrap. Unsharing threads does nothing to a process without any, else it fails.
        return bool(kernel.libc.unshare(_CLONE_THREAD))


def forbid_new_privileges() -> None:
    """No set-uid program raises this process or its children; needed by Landlock and seccomp."""
    kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)


def die_with_parent() -> None:
    """Be killed when the grader's thread that started this process ends.

    A change of uid clears the wish, so it comes after :func:`become`.
    """
    parent = os.getppid()
    kernel.prctl(kernel.PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def forbid_debugging() -> None:
    """Nobody but root may trace this process or read its memory through /proc."""
    kernel.prctl(kernel.PR_SET_DUMPABLE, 0)


_holders = 0


def hold_undumpable() -> None:
    """Make the grader itself unreadable for others of its uid until the last :func:`release_undumpable`."""
    global _holders
    with _lock:
        _holders += 1
        if _holders == 1:
            kernel.prctl(kernel.PR_SET_DUMPABLE, 0)


def release_undumpable() -> None:
    """The counterpart of :func:`hold_undumpable`."""
    global _holders
    with _lock:
        _holders -= 1
        if _holders == 0:
            kernel.prctl(kernel.PR_SET_DUMPABLE, 1)
