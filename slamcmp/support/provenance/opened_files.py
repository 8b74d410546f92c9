"""Which files code reads that nobody declared: what a result depends on beside its key.

Python tells of every file that it opens, and of every folder that it lists (audit events). A library in C
that opens files by itself does not: of what was read that way it is only known that there is something, where
the system counts what a process reads (:mod:`slamcmp.support.provenance.unseen_reads`), or that there may be.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from slamcmp import loaded_code
from slamcmp.loaded_code import is_library, loaded_digests
from slamcmp.support.provenance.code_version import PACKAGE, file_digest, stamp
from slamcmp.support.provenance.unseen_reads import UnseenReads, paused

UNKNOWN = "?"
"""In place of a path: something was read that nobody saw; the value says what may have read it."""
ABSENT = "absent"
CHANGING = "changed while it was read"
SYSTEM = ("/proc", "/sys", "/dev", "/etc", "/usr", "/lib", "/lib64", "/bin", "/sbin", "/run")
WITHOUT_SIZE = ("/proc/", "/sys/")
_LARGEST = 1 << 16
CACHES = frozenset({"__pycache__", ".cache", ".config", ".numba_cache", ".git"})
OTHER_PROGRAMS = {
    "subprocess.Popen": "another program",
    "os.system": "another program",
    "os.exec": "another program",
    "os.posix_spawn": "another program",
    "os.fork": "another process",
    "socket.connect": "the network",
}


class OpenedFiles:
    """The files and folders that were opened for reading while this was the one that watched."""

    def __init__(self, ignored: tuple[Path, ...] = ()) -> None:
        self._ignored = (*map(str, ignored), str(PACKAGE), *SYSTEM)
        self._stamps: dict[str, tuple[int, ...] | None] = {}
        self._written: set[str] = set()
        self.loaded_before = loaded_digests()
        """Modules are known by what was executed, not by the file that was opened."""
        self.unseen: dict[str, None] = {}
        """What may have read something that is not among the files."""
        self.calls_c = False
        """Whether functions of a C library were called by hand (ctypes)."""
        self.vouched = False
        """Whether what runs at present is somebody's who says what it reads."""
        self.sizes_known = True
        """False once a file was opened that has no size, as the system's own ones."""
        self.told_bytes = 0
        """Sizes of the files opened for reading, together, whichever they are."""
        self.reads = UnseenReads(self)
        """To be asked where a library may have read by itself."""

    def inputs(self, known: Mapping[str, str]) -> dict[str, str]:
        """The digest of each, by absolute path, but for the files that are ``known`` by their digest."""
        found: dict[str, str] = {}
        for path, at_opening in sorted(self._stamps.items()):
            if path in self._written or os.path.realpath(path) in known:
                continue
            now = _stamp(path)
            if now is not None and not _is_readable(path):
                continue
            found[path] = digest_of_input(path) if now == at_opening else CHANGING
        return found

    @contextlib.contextmanager
    def trusted(self) -> Iterator[None]:
        """What runs meanwhile says what it reads: nobody asks what else it does."""
        before, self.vouched = self.vouched, True
        try:
            with paused():
                yield
        finally:
            self.vouched = before

    def has_seen(self, path: str) -> bool:
        """Whether the file is among those that were opened."""
        return os.path.abspath(path) in self._stamps

    def note(self, event: str, arguments: tuple[Any, ...]) -> None:
        """An audit event."""
        if event == "open":
            path, mode, flags = arguments
            self._opened(path, mode, flags)
            self._count(path, mode, flags)
        elif event in ("os.listdir", "os.scandir"):
            # Python's search for modules lists folders too.
            if not sys._getframe(2).f_code.co_filename.startswith("<frozen importlib"):
                self._opened("." if arguments[0] is None else arguments[0], "r", 0)
        elif event in ("sqlite3.connect", "ctypes.dlopen"):
            self.calls_c = self.calls_c or (event == "ctypes.dlopen" and not self.vouched)
            if isinstance(arguments[0], str | bytes) and os.sep in os.fsdecode(arguments[0]):
                self._opened(arguments[0], "r", 0)
        elif event in OTHER_PROGRAMS and not self.vouched:
            self.unseen[OTHER_PROGRAMS[event]] = None

    def _opened(self, path: Any, mode: Any, flags: Any) -> None:
        if not isinstance(path, str | bytes | os.PathLike):
            return
        absolute = os.path.abspath(os.fsdecode(path))
        if _writes(mode, flags):
            self._written.add(absolute)
        elif absolute not in self._stamps and not self._is_ignored(absolute):
            self._stamps[absolute] = _stamp(absolute)

    def _count(self, path: Any, mode: Any, flags: Any) -> None:
        if not _writes(mode, flags):
            # A file that is not there, or is no file, gives nothing to read.
            with contextlib.suppress(OSError, TypeError, ValueError):
                self.told_bytes += os.stat(path).st_size
                if self.reads.going and os.path.abspath(os.fsdecode(path)).startswith(WITHOUT_SIZE):
                    self._measure(path)

    def _measure(self, path: Any) -> None:
        """Count a file of the system's, which has no size before it is read."""
        global _watching
        before, _watching = _watching, None
        try:
            with open(path, "rb", buffering=0) as file:
                size = len(file.read(_LARGEST))
            # This look, and what is about to be read.
            self.told_bytes += 2 * size
            self.sizes_known = self.sizes_known and 0 < size < _LARGEST
        finally:
            _watching = before

    def _is_ignored(self, absolute: str) -> bool:
        within = any(absolute == each or absolute.startswith(each + os.sep) for each in self._ignored)
        return within or not CACHES.isdisjoint(absolute.split(os.sep)) or is_library(Path(absolute))


_watching: OpenedFiles | None = None
_installed = False


@contextlib.contextmanager
def watched(opened: OpenedFiles) -> Iterator[OpenedFiles]:
    """Note in ``opened`` what this process, all of its threads, opens meanwhile."""
    global _watching, _installed
    if not _installed:
        # It stays for the life of the process, and does nothing while nobody watches.
        sys.addaudithook(_hook)
        loaded_code.around_library_imports = paused
        _installed = True
    before, _watching = _watching, opened
    try:
        yield opened
    finally:
        _watching = before


def digest_of_input(path: str) -> str:
    """sha256 of a file, or of the names, sizes and times in a folder; a word where there is neither."""
    try:
        if not os.path.isdir(path):
            return file_digest(Path(path)) if os.path.exists(path) else ABSENT
        entries = sorted(os.scandir(path), key=lambda entry: entry.name)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    told = [
        [entry.name] if entry.is_dir() else [entry.name, *_size_and_time(entry)]
        for entry in entries
        if entry.name not in CACHES and not entry.name.startswith(".")
    ]
    return hashlib.sha256(repr(told).encode(errors="backslashreplace")).hexdigest()


def unchanged(inputs: Mapping[str, str]) -> bool:
    """Whether all that was read is still the same, and nothing was read that nobody saw."""
    return UNKNOWN not in inputs and not changed(inputs)


def changed(inputs: Mapping[str, str]) -> list[str]:
    """The paths of what was read and is not any more what it was."""
    return [path for path, known in inputs.items() if path != UNKNOWN and digest_of_input(path) != known]


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    opened = _watching
    if opened is not None:
        # What is raised here would end up in the code that opens the file.
        with contextlib.suppress(Exception):
            opened.note(event, arguments)


def _writes(mode: Any, flags: Any) -> bool:
    if isinstance(mode, str):
        return any(letter in mode for letter in "wax+")
    return bool(int(flags) & (os.O_WRONLY | os.O_RDWR))


def _stamp(path: str) -> tuple[int, ...] | None:
    try:
        return stamp(Path(path))
    except OSError:
        return None


def _is_readable(path: str) -> bool:
    mode = os.stat(path).st_mode
    return stat.S_ISREG(mode) or stat.S_ISDIR(mode)


def _size_and_time(entry: os.DirEntry[str]) -> tuple[int, int]:
    try:
        status = entry.stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns
