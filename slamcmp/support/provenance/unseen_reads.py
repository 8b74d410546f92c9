"""Whether a process read anything that Python did not tell of: bytes counted by the system (Linux).

A library in C opens files by itself, and no audit event says so. The system counts what a process reads all
the same ("rchar" in ``/proc/self/io``); what is left of that after the files that Python told of was read by
somebody else. Where both agree to the byte nothing was.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from typing import Protocol

COUNTERS, MAPPINGS = "/proc/self/io", "/proc/self/maps"
NO_FILES = ("/dev/", "/memfd:", "/SYSV", "/proc/")


class Told(Protocol):
    """What Python tells of."""

    told_bytes: int
    """Sizes of the files opened for reading so far, together."""

    def has_seen(self, path: str) -> bool:
        """Whether this file is one of them."""


class UnseenReads:
    """Counts while :meth:`counted` lasts, but for what is :func:`paused`.

    Args:
        told: what Python tells meanwhile.
    """

    def __init__(self, told: Told) -> None:
        self._told = told
        self._counters: int | None = None
        self._since: tuple[int, int] | None = None
        self._difference, self._excess, self._counted = 0, 0, 0
        self._mapped: set[str] = set()
        self._finished = False
        self._looks = 0
        """Bytes that reading the counters took."""

    @property
    def nothing(self) -> bool:
        """Whether all that was read in the counted stretches is known; False where nobody could count."""
        return self._finished and not self._difference and not self._mapped

    @property
    def more_than_told(self) -> bool:
        """Whether a file was mapped, or more read than all that was told, read twice over, would make."""
        return self._finished and (self._excess > self._counted or bool(self._mapped))

    @contextlib.contextmanager
    def counted(self) -> Iterator[None]:
        """Count what this process, all of its threads, reads meanwhile."""
        global _counting
        # The C library reads the time zone once, at the first look at a clock.
        time.localtime()
        try:
            self._counters = os.open(COUNTERS, os.O_RDONLY)
            before = self._mappings()
        except OSError:
            yield
            return
        outer, _counting = _counting, self
        self.go_on()
        try:
            yield
        finally:
            self.pause()
            _counting = outer
            with contextlib.suppress(OSError):
                new = self._mappings() - before
                # A file that is mapped is read without a call that could be counted.
                self._mapped |= {path for path in new if not self._told.has_seen(path)}
                self._finished = True
            os.close(self._counters)

    @property
    def going(self) -> bool:
        """Whether it counts at this moment."""
        return self._since is not None

    def go_on(self) -> None:
        """Count from here."""
        self._since = self._now()

    def pause(self) -> None:
        """Take in what was read since."""
        if self._since is not None:
            (read, told), (read_before, told_before) = self._now(), self._since
            # Either way: a file that was told and not read whole could hide another that was not told.
            difference = (read - read_before) - (told - told_before)
            self._difference += abs(difference)
            self._excess += max(0, difference)
            self._counted += told - told_before
            self._since = None

    def _now(self) -> tuple[int, int]:
        """Bytes read so far by this process, but for this look, and those that Python told of."""
        assert self._counters is not None
        text = os.pread(self._counters, 4096, 0)
        self._looks += len(text)
        return int(text.split()[1]) - self._looks + len(text), self._told.told_bytes

    @staticmethod
    def _mappings() -> set[str]:
        with open(MAPPINGS, "rb") as file:
            paths = {line.split(maxsplit=5)[-1].strip() for line in file if b"/" in line}
        named = {os.fsdecode(path) for path in paths}
        return {
            path
            for path in named
            if path.startswith("/") and not path.startswith(NO_FILES) and ".so" not in os.path.basename(path)
        }


_counting: UnseenReads | None = None


@contextlib.contextmanager
def paused() -> Iterator[None]:
    """What is read meanwhile is slamcmp's own business, or a library's that is being imported."""
    counting = _counting
    if counting is None or not counting.going:
        yield
        return
    counting.pause()
    try:
        yield
    finally:
        counting.go_on()
