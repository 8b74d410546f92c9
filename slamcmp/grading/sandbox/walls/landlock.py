"""Layer: Landlock. The process opens nothing but what is listed, read-only, whoever it runs as."""

from __future__ import annotations

import os
import stat
import struct

from slamcmp.grading.sandbox.policy import Readable
from slamcmp.grading.sandbox.walls import kernel
from slamcmp.grading.sandbox.walls.syscalls import number

EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_RULE_PATH_BENEATH = 1
# The number of file-access rights that each version of the interface knows; more may come, none goes away.
_RIGHTS_OF_ABI = {1: 13, 2: 14, 3: 15, 4: 15}
_RIGHTS_FROM_ABI_5 = 16
_NET_ALL = 0b11
_SCOPE_ALL = 0b11


def landlock_abi() -> int:
    """The kernel's version of the interface.

    Raises:
        OSError: the kernel has no Landlock.
    """
    return kernel.call(_number("landlock_create_ruleset"), None, 0, 1)


def apply_landlock(readable: Readable) -> int:
    """Restrict this thread, and those it starts; returns the version of the interface used.

    Version 4 adds TCP, version 6 signals and abstract sockets to what is refused.

    Raises:
        OSError: the kernel has no Landlock, or no_new_privs is not set.
    """
    abi = landlock_abi()
    rights = (1 << _RIGHTS_OF_ABI.get(abi, _RIGHTS_FROM_ABI_5)) - 1
    attributes = struct.pack("=Q", rights)
    if abi >= 4:
        attributes += struct.pack("=Q", _NET_ALL)
    if abi >= 6:
        attributes += struct.pack("=Q", _SCOPE_ALL)
    rules = kernel.call(_number("landlock_create_ruleset"), attributes, len(attributes), 0)
    try:
        for path in readable.trees:
            _allow(rules, path, READ_FILE | READ_DIR)
        for folder, masked in readable.libraries:
            _allow(rules, folder, READ_DIR)
            for entry in os.scandir(folder):
                if entry.name not in masked:
                    _allow(rules, entry.path, READ_FILE | READ_DIR)
        for path in readable.listed:
            _allow(rules, path, READ_DIR)
        for path in readable.devices:
            _allow(rules, path, READ_FILE | WRITE_FILE)
        kernel.call(_number("landlock_restrict_self"), rules, 0)
    finally:
        os.close(rules)
    return abi


def _number(name: str) -> int:
    value = number(name, kernel.machine())
    assert value is not None
    return value


def _allow(rules: int, path: str, access: int) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        if not stat.S_ISDIR(os.fstat(descriptor).st_mode):
            access &= READ_FILE | WRITE_FILE
        if access:
            rule = struct.pack("=Qi", access, descriptor)
            kernel.call(_number("landlock_add_rule"), rules, _RULE_PATH_BENEATH, rule, 0)
    finally:
        os.close(descriptor)
