"""What one sandboxed process may use.

The worker imports this while it starts: data only.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """Limits and packages of an experiment; the defaults fit the course's planar assignments."""

    packages: tuple[str, ...] = ("numpy", "scipy")
    """Import names that the submission may use; imported by it, files readable."""
    preload: tuple[str, ...] = ("numpy",)
    """Of these, what the worker imports before it closes, so that the import costs the student no time."""
    modules: tuple[str, ...] = ("slamcmp.models.sensors",)
    """Parts of slamcmp that the submission may import besides ``slamcmp.types``; nothing else is readable."""
    inert: tuple[str, ...] = ("matplotlib",)
    """Packages that import as modules which do nothing, unless they are among ``packages``."""
    memory_bytes: int = 2 << 30
    """Address space, not resident memory: gtsam and OpenCV together need most of 1 GB of it."""
    cpu_s: float = 300.0
    """Processor time of the whole process; the backstop should the grader itself die."""
    start_s: float = 30.0
    load_s: float = 10.0
    """Time to import the submission."""
    request_s: float = 5.0
    """Time for each other request, unless the call names its own."""
    threads: int = 64
    """Enforced where the process has a uid of its own, elsewhere memory is the limit."""
    open_files: int = 64
    reply_bytes: int = 16 << 20
    """Largest body of one answer."""
    output_bytes: int = 64 << 10
    """Kept of everything the submission prints; the rest is counted and thrown away."""


@dataclass(frozen=True)
class Readable:
    """Paths by the way they may be used; all of them absolute."""

    trees: tuple[str, ...] = ()
    """Folders with all beneath them, or single files."""
    libraries: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Folders of which everything but the named entries may be read."""
    listed: tuple[str, ...] = ()
    """Folders whose names may be listed: Python's import asks for that."""
    devices: tuple[str, ...] = ("/dev/null", "/dev/urandom")
