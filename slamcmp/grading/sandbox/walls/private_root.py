"""Layer, as root: a mount namespace whose root holds only what may be read, and that read-only.

It makes paths outside unreachable even by ``stat``, and paths inside reachable for a uid without rights when
a folder above them is private (an interpreter below ``/root``, say).
"""

from __future__ import annotations

import ctypes
import os
import struct

from slamcmp.grading.sandbox.policy import Readable
from slamcmp.grading.sandbox.walls import kernel
from slamcmp.grading.sandbox.walls.syscalls import number

_CLONE_NEWNS, _CLONE_NEWIPC = 0x00020000, 0x08000000
_MS_BIND, _MS_REC, _MS_PRIVATE = 0x1000, 0x4000, 0x40000
_MS_NOSUID, _MS_NODEV = 0x2, 0x4
_MNT_DETACH = 2
_AT_FDCWD, _AT_RECURSIVE = -100, 0x8000
_ATTR_RDONLY, _ATTR_NOSUID, _ATTR_NODEV = 0x1, 0x2, 0x4


def enter_private_root(readable: Readable, mount_point: str) -> None:
    """Leave the machine's file system for good; nothing of it stays mounted but what ``readable`` lists.

    Raises:
        OSError: no right to mount (a container), or a kernel before 5.12.
    """
    # The folders made here are passed through by a user without rights, whatever the staff's umask is.
    os.umask(0o022)
    flags = _CLONE_NEWNS | _CLONE_NEWIPC
    _checked(kernel.libc.unshare(flags), "unshare")
    _mount(None, "/", None, _MS_REC | _MS_PRIVATE)
    _tmpfs(mount_point)
    for folder, masked in readable.libraries:
        _bind(folder, mount_point)
        for name in masked:
            if os.path.isdir(os.path.join(folder, name)):
                _tmpfs(mount_point + os.path.join(folder, name))
    for path in readable.listed:
        os.makedirs(mount_point + path, mode=0o755, exist_ok=True)
    for path in readable.trees:
        _bind(path, mount_point)
    for path in readable.devices:
        _empty_file(mount_point + path)
    _read_only(mount_point)
    # After the rest: on a mount without devices they could not be opened.
    for path in readable.devices:
        _mount(path, mount_point + path, None, _MS_BIND)
    os.chdir(mount_point)
    pivot_root = number("pivot_root", kernel.machine())
    assert pivot_root is not None
    # Both at the same place: the old root then lies over the new one and is taken off, no folder needed.
    kernel.call(pivot_root, b".", b".")
    _checked(kernel.libc.umount2(b".", _MNT_DETACH), "umount2")
    os.chdir("/")


def _bind(path: str, mount_point: str) -> None:
    target = mount_point + path
    if os.path.isdir(path):
        os.makedirs(target, mode=0o755, exist_ok=True)
    else:
        _empty_file(target)
    _mount(path, target, None, _MS_BIND)


def _empty_file(path: str) -> None:
    os.makedirs(os.path.dirname(path), mode=0o755, exist_ok=True)
    os.close(os.open(path, os.O_CREAT | os.O_RDONLY | os.O_CLOEXEC, 0o444))


def _tmpfs(path: str) -> None:
    _mount("tmpfs", path, "tmpfs", _MS_NOSUID | _MS_NODEV, b"mode=0755,size=1m")


def _read_only(path: str) -> None:
    mount_setattr = number("mount_setattr", kernel.machine())
    assert mount_setattr is not None
    attributes = struct.pack("=QQQQ", _ATTR_RDONLY | _ATTR_NOSUID | _ATTR_NODEV, 0, 0, 0)
    kernel.call(mount_setattr, _AT_FDCWD, os.fsencode(path), _AT_RECURSIVE, attributes, len(attributes))


def _mount(source: str | None, target: str, kind: str | None, flags: int, data: bytes | None = None) -> None:
    names = (None if name is None else os.fsencode(name) for name in (source, target, kind))
    _checked(kernel.libc.mount(*names, ctypes.c_ulong(flags), data), f"mount on {target}")


def _checked(result: int, what: str) -> None:
    if result == -1:
        error = ctypes.get_errno()
        raise OSError(error, f"{what}: {os.strerror(error)}")
