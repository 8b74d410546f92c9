"""Layer, where not root: ``bwrap`` starts the worker in a file system that holds only what it needs."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from slamcmp.grading.sandbox.policy import Readable

# No own pid namespace: the worker's pid as the grader sees it is the one whose processor time it reads.
_ISOLATION = ("--unshare-user", "--unshare-ipc", "--unshare-net", "--unshare-uts", "--die-with-parent")


def bubblewrap_command(readable: Readable, start_files: Sequence[str]) -> list[str]:
    """The words to put before the worker's command; ``start_files`` are needed before the worker closes.

    Without :func:`bubblewrap_works`, meaningless.
    """
    words = [shutil.which("bwrap") or "bwrap", *_ISOLATION]
    for folder, masked in readable.libraries:
        words += ["--ro-bind", folder, folder]
        for name in masked:
            if os.path.isdir(os.path.join(folder, name)):
                words += ["--tmpfs", os.path.join(folder, name)]
    for path in readable.listed:
        words += ["--dir", path]
    for path in (*readable.trees, *_interpreter(), *start_files):
        words += ["--ro-bind-try", path, path]
    for path in readable.devices:
        words += ["--dev-bind", path, path]
    return [*words, "--remount-ro", "/", "--chdir", "/", "--"]


@functools.cache
def bubblewrap_works() -> bool:
    """Whether ``bwrap`` is installed and allowed to make namespaces here."""
    if shutil.which("bwrap") is None:
        return False
    words = [shutil.which("bwrap") or "", *_ISOLATION, "--ro-bind", "/", "/", "true"]
    return subprocess.run(words, capture_output=True, timeout=10, check=False).returncode == 0


@functools.cache
def _interpreter() -> tuple[str, ...]:
    """The executable, each link on the way to it, and what tells Python where its libraries are."""
    found = [os.path.join(sys.prefix, "pyvenv.cfg")]
    current = Path(sys.executable)
    while True:
        found.append(str(current))
        if not current.is_symlink():
            break
        current = Path(os.path.normpath(current.parent / os.readlink(current)))
    return tuple(found)
