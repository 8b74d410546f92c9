"""How much memory a stretch of work took, and how much it may take."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import sys
from pathlib import Path

from slamcmp.support.unseen_reads import paused

MB = 1024 * 1024
_TRIM = getattr(ctypes.CDLL(None), "malloc_trim", None)
"""Of glibc alone. Found here, where nobody watches what a plug-in calls."""


class PeakMemory:
    """Growth of this process's peak resident memory from the construction on."""

    def __init__(self) -> None:
        _give_back()
        # Linux can reset the peak, so that what came before the run does not hide its own.
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
        self._start = _peak_mb()

    def growth_mb(self) -> float:
        """Growth up to now [MB]."""
        return max(0.0, _peak_mb() - self._start)


def _give_back() -> None:
    """Let go of memory that earlier work of this process freed: taken again, it would not show as growth."""
    if _TRIM is not None:
        _TRIM(0)


def _peak_mb() -> float:
    with contextlib.suppress(OSError), paused():
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / MB if sys.platform == "darwin" else peak / 1024


def machine_memory_mb() -> float:
    """Physical memory of the machine [MB]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / MB


def limit_growth(limit_mb: float) -> None:
    """Make allocations of this process fail once it has grown by ``limit_mb`` (where the system can)."""
    try:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return
    ceiling = used + int(limit_mb * MB)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or ceiling < hard:
        resource.setrlimit(resource.RLIMIT_AS, (ceiling, hard))
