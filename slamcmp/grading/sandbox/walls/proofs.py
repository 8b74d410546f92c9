"""What the worker tries before it loads foreign code, once open and once closed.

The open attempt is the control: only where it succeeded does a refusal afterwards prove anything.
"""

from __future__ import annotations

import _socket
import contextlib
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

Outcome = Literal["proved", "not proved", "failed"]
Level = Literal["strong", "names visible", "reads unprotected", "weak"]

MEANING = {
    "read_private_file": "cannot read a file that only the grader's user may read",
    "read_public_file": "cannot read a file outside its own that every user may read",
    "look_up_file": "cannot learn whether a file outside its own exists",
    "list_folder": "cannot list a folder outside its own",
    "write_file": "cannot create a file in a folder that every user may write",
    "signal_parent": "cannot send a signal to the grader",
    "read_parent": "cannot read the grader's environment",
    "open_socket": "cannot open a network socket",
    "fork": "cannot start a process",
    "execute": "cannot become another program",
}
"""Every attempt, in words for the report."""

_READS = ("read_private_file", "read_public_file", "list_folder", "read_parent")
_NAMES = ("look_up_file",)


@dataclass(frozen=True)
class Targets:
    """What the attempts are made on; laid out by the grader, so that there is something to reach."""

    private_file: str
    public_file: str
    writable_folder: str
    parent: int


IN_THE_GRADER = (
    "read_private_file",
    "read_public_file",
    "look_up_file",
    "list_folder",
    "write_file",
    "read_parent",
)
"""Attempts that the grader may make itself as a control, where the worker starts half closed already."""


def attempt(targets: Targets, names: Iterable[str] = tuple(MEANING)) -> dict[str, bool]:
    """Try each of the names; True where it succeeded."""
    public_folder = os.path.dirname(targets.public_file)
    attempts: dict[str, Callable[[], object]] = {
        "read_private_file": lambda: _read(targets.private_file),
        "read_public_file": lambda: _read(targets.public_file),
        "look_up_file": lambda: os.stat(targets.public_file),
        "list_folder": lambda: os.listdir(public_folder),
        "write_file": lambda: _write(os.path.join(targets.writable_folder, f"attempt-{os.getpid()}")),
        "signal_parent": lambda: os.kill(targets.parent, 0),
        "read_parent": lambda: _open(f"/proc/{targets.parent}/environ"),
        "open_socket": lambda: _socket.socket().close(),
        "fork": _fork,
        "execute": _execute,
    }
    return {name: _succeeds(attempts[name]) for name in names}


def judge(control: Mapping[str, bool], closed: Mapping[str, bool]) -> dict[str, Outcome]:
    """The outcome of each attempt from its success before and after closing."""
    outcomes: dict[str, Outcome] = {}
    for name in MEANING:
        if closed.get(name, True):
            outcomes[name] = "failed"
        else:
            outcomes[name] = "proved" if control.get(name, False) else "not proved"
    return outcomes


def level_of(proofs: Mapping[str, Outcome]) -> Level:
    """The summary: ``strong`` needs everything proved; see docs/grading-security.md for the others."""
    missing = {name for name in MEANING if proofs.get(name) != "proved"}
    if not missing:
        return "strong"
    if missing <= set(_NAMES):
        return "names visible"
    return "reads unprotected" if missing <= {*_NAMES, *_READS} else "weak"


def _succeeds(action: Callable[[], object]) -> bool:
    try:
        action()
    except OSError:
        return False
    return True


def _open(path: str) -> None:
    os.close(os.open(path, os.O_RDONLY | os.O_CLOEXEC))


def _read(path: str) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.read(descriptor, 1)
    finally:
        os.close(descriptor)


def _write(path: str) -> None:
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600))
    with contextlib.suppress(OSError):
        os.unlink(path)


def _fork() -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def _execute() -> None:
    # A program that is not there: allowed, the kernel says "no such file"; forbidden, it does not look.
    with contextlib.suppress(FileNotFoundError):
        os.execv("/nonexistent/program", ["program"])
