"""How much memory a stretch of work took, and how much it may take."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import sys
from pathlib import Path

from slamcmp.support.provenance.unseen_reads import paused

MB = 1024 * 1024
_C = ctypes.CDLL(None)
_TRIM, _SET_OPTION = getattr(_C, "malloc_trim", None), getattr(_C, "mallopt", None)
"""Of glibc alone. Found here, where nobody watches what a plug-in calls."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Of glibc's ``malloc.h``."""


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


def keep_freed_memory() -> None:
    """Keep up to 64 MB that this process frees, instead of handing each image's back to the system.

    An image's arrays are some megabytes, which glibc takes from the system for every image anew: its pages
    are cleared by the kernel one by one, which took a third of the front end's time. Holds for the process
    from here on. Other systems' allocators, and settings of the user's own in the environment, are left
    alone.
    """
    if any(name in os.environ for name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")):
        return
    if _TRIM is not None and _SET_OPTION is not None:
        _SET_OPTION(_M_TRIM_THRESHOLD, 64 * MB)
        # The largest that glibc allows.
        _SET_OPTION(_M_MMAP_THRESHOLD, 32 * MB)


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
