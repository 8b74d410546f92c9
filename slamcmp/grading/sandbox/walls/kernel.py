"""System calls that Python's standard library does not offer."""

from __future__ import annotations

import ctypes
import os
import platform

libc = ctypes.CDLL(None, use_errno=True)
libc.syscall.restype = ctypes.c_long

PR_SET_PDEATHSIG, PR_GET_DUMPABLE, PR_SET_DUMPABLE = 1, 3, 4
PR_SET_NO_NEW_PRIVS, PR_GET_NO_NEW_PRIVS = 38, 39


def machine() -> str:
    """``x86_64`` or ``aarch64`` as the kernel names them; anything else has no syscall table here."""
    name = platform.machine()
    return {"arm64": "aarch64", "amd64": "x86_64", "AMD64": "x86_64"}.get(name, name)


def call(number: int, *arguments: int | bytes | ctypes.Array[ctypes.c_char] | None) -> int:
    """``syscall(2)``.

    Raises:
        OSError: with the kernel's error number.
    """
    # Bare Python integers would be passed as C ints and lose their upper half.
    passed = [ctypes.c_long(value) if isinstance(value, int) else value for value in arguments]
    ctypes.set_errno(0)
    result = int(libc.syscall(ctypes.c_long(number), *passed))
    if result == -1 and ctypes.get_errno():
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result


def prctl(option: int, argument: int = 0) -> int:
    """``prctl(2)`` with one argument.

    Raises:
        OSError: with the kernel's error number.
    """
    ctypes.set_errno(0)
    zero = ctypes.c_ulong(0)
    result = int(libc.prctl(option, ctypes.c_ulong(argument), zero, zero, zero))
    if result == -1:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result
