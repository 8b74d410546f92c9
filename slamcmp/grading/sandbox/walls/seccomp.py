"""Layer: a seccomp filter that refuses the system calls in ``syscalls.DENIED`` and some arguments of others.

The program is classic BPF over ``struct seccomp_data``: number at byte 0, architecture at 4, six 64-bit
arguments from 16. Each test is a conditional jump over its own return, so no jump is ever long.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct

from slamcmp.grading.sandbox.walls import kernel
from slamcmp.grading.sandbox.walls.syscalls import DENIED, NEWEST_KNOWN, number

AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}

_SET_MODE_FILTER, _FLAG_TSYNC = 1, 1
_ALLOW, _ERRNO, _KILL_PROCESS = 0x7FFF0000, 0x00050000, 0x80000000
_LOAD_WORD, _RETURN = 0x20, 0x06
_JUMP_EQUAL, _JUMP_GREATER, _JUMP_ANY_BIT = 0x15, 0x25, 0x45
_NUMBER_AT, _ARCH_AT, _ARGUMENTS_AT = 0, 4, 16
_X32_BIT = 0x40000000
_CLONE_THREAD = 0x00010000

_PRCTL_ALLOWED = (15, 16, 3, 39, 21)
"""Set and get the thread's name; get dumpable, no_new_privs, seccomp's mode."""
_FCNTL_DENIED = (8, 10, 15, 1026)
"""F_SETOWN, F_SETSIG, F_SETOWN_EX, F_NOTIFY: they make the kernel send signals to others."""
_IOCTL_DENIED = (0x8901, 0x8902, 0x5412, 0x541C)
"""FIOSETOWN, SIOCSPGRP likewise; TIOCSTI and TIOCLINUX type into a terminal."""
_OPEN_CHANGING = 0o1 | 0o2 | 0o100 | 0o1000
"""O_WRONLY, O_RDWR, O_CREAT, O_TRUNC: the same on both architectures."""

Instruction = tuple[int, int, int, int]


def program(machine: str, pid: int, *, open_to_write: bool = True) -> list[Instruction]:
    """The filter for a process: (code, jump if true, jump if false, constant) an instruction.

    ``open_to_write=False`` is for where nothing else protects files: the grader's own could be emptied.
    """
    deny = _ERRNO | errno.EPERM
    unknown = _ERRNO | errno.ENOSYS
    lines: list[Instruction] = [
        (_LOAD_WORD, 0, 0, _ARCH_AT),
        (_JUMP_EQUAL, 1, 0, AUDIT_ARCH[machine]),
        (_RETURN, 0, 0, _KILL_PROCESS),
        (_LOAD_WORD, 0, 0, _NUMBER_AT),
    ]
    if machine == "x86_64":
        lines += _when(_JUMP_ANY_BIT, _X32_BIT, [(_RETURN, 0, 0, _KILL_PROCESS)])
    lines += _when(_JUMP_GREATER, NEWEST_KNOWN, [(_RETURN, 0, 0, unknown)])
    for name in DENIED:
        nr = number(name, machine)
        if nr is not None:
            lines += _when(_JUMP_EQUAL, nr, [(_RETURN, 0, 0, deny)])

    def filtered(name: str, body: list[Instruction]) -> None:
        nr = number(name, machine)
        if nr is not None:
            lines.extend(_when(_JUMP_EQUAL, nr, body))

    # glibc falls back to clone, whose flags a filter can see.
    filtered("clone3", [(_RETURN, 0, 0, unknown)])
    filtered("clone", [*_argument(0), (_JUMP_ANY_BIT, 1, 0, _CLONE_THREAD), *_verdicts(deny)])
    for name in ("kill", "tgkill", "rt_sigqueueinfo", "rt_tgsigqueueinfo"):
        filtered(name, [*_argument(0), (_JUMP_EQUAL, 1, 0, pid), *_verdicts(deny)])
    for name in ("prlimit64", "sched_setaffinity"):
        filtered(name, [*_argument(0), (_JUMP_EQUAL, 2, 0, 0), (_JUMP_EQUAL, 1, 0, pid), *_verdicts(deny)])
    filtered("prctl", _one_of(0, _PRCTL_ALLOWED, then=_ALLOW, otherwise=deny))
    filtered("fcntl", _one_of(1, _FCNTL_DENIED, then=deny, otherwise=_ALLOW))
    filtered("ioctl", _one_of(1, _IOCTL_DENIED, then=deny, otherwise=_ALLOW))
    if not open_to_write:
        for name, flags_at in (("open", 1), ("openat", 2)):
            changing = (_JUMP_ANY_BIT, 0, 1, _OPEN_CHANGING)
            filtered(name, [*_argument(flags_at), changing, *_verdicts(deny)])
        filtered("openat2", [(_RETURN, 0, 0, unknown)])
    return [*lines, (_RETURN, 0, 0, _ALLOW)]


def apply_seccomp(*, open_to_write: bool = True) -> None:
    """Install the filter on every thread of this process.

    Raises:
        OSError: the kernel has no seccomp filters, or no_new_privs is not set.
        NotImplementedError: no syscall table for this architecture.
    """
    machine = kernel.machine()
    seccomp = number("seccomp", machine)
    assert seccomp is not None
    lines = program(machine, os.getpid(), open_to_write=open_to_write)
    code = b"".join(struct.pack("=HBBI", *line) for line in lines)
    buffer = ctypes.create_string_buffer(code, len(code))
    described = struct.pack("@HxxxxxxQ", len(lines), ctypes.addressof(buffer))
    kernel.call(seccomp, _SET_MODE_FILTER, _FLAG_TSYNC, described)


def _when(jump: int, constant: int, body: list[Instruction]) -> list[Instruction]:
    """``body``, which must end in a return, run only if the comparison with the loaded word holds."""
    return [(jump, 0, len(body), constant), *body]


def _argument(index: int) -> list[Instruction]:
    """Load the lower half of an argument: the kernel reads pids, flags and commands as 32-bit numbers."""
    return [(_LOAD_WORD, 0, 0, _ARGUMENTS_AT + 8 * index)]


def _verdicts(deny: int) -> list[Instruction]:
    return [(_RETURN, 0, 0, deny), (_RETURN, 0, 0, _ALLOW)]


def _one_of(index: int, constants: tuple[int, ...], *, then: int, otherwise: int) -> list[Instruction]:
    tests: list[Instruction] = []
    for constant in constants:
        tests += _when(_JUMP_EQUAL, constant, [(_RETURN, 0, 0, then)])
    return [*_argument(index), *tests, (_RETURN, 0, 0, otherwise)]
