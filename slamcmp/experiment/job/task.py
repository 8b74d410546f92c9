"""A job as a worker is told about it, and where its files lie in the results folder."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from slamcmp.experiment.config.record import Record
from slamcmp.registry import Plugin
from slamcmp.support.provenance.code_version import PACKAGE

BEATS = 5
"""Numbers in a heartbeat: the time of the start, the frames done, the times of the last frame and of the last
answer, and why there is no result."""


@dataclass(frozen=True)
class Task:
    """A job as a worker needs it: names and plain values only."""

    kind: str
    """``stream`` or ``run``."""
    key: str
    folder: Path
    """The results folder."""
    plugins: tuple[tuple[str, Mapping[str, Any]], ...]
    """Specification and parameters: of source and front end, or of the back end."""
    seed: int | None
    label: str = ""
    stream_key: str = ""
    digest: str = ""
    """Of the stream that a run reads."""
    time_limit_s: float = float("inf")
    memory_limit_mb: float | None = None
    record: Record | None = None
    """What to record besides."""
    own_gate: float | None = None
    """Probability of a gate by the back end's own covariance."""
    code: Mapping[str, str] = field(default_factory=dict)
    """sha256 of each source file that the result is named by, by absolute path."""
    data: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """What each declared data file looked like when it was hashed."""
    watched: bool = False
    """Whether to note which other files are read: plug-ins of users do not declare them all."""
    declared: tuple[bool, ...] = (False,)
    """Of each plug-in whether somebody vouches for what nobody sees: it is our own, or its author says which
    files it reads."""
    alone: bool = False
    """Whether no other job runs beside it: its times are then the back end's own."""
    shares_process: bool = False
    """Whether other such jobs may run before and after it in one process: all its plug-ins are our own."""

    @property
    def result(self) -> Path:
        """The file that this job leaves."""
        return (truth_path if self.kind == "stream" else run_path)(self.folder, self.key)

    @property
    def log(self) -> Path:
        """Where what it prints goes."""
        return self.folder / "logs" / f"{self.key}.log"


def run_path(folder: Path, key: str) -> Path:
    """Where the run of that key lies."""
    return folder / "runs" / f"{key}.npz"


def posteriors_path(folder: Path, key: str) -> Path:
    """Where the posteriors that the run of that key kept lie, if it kept any."""
    return folder / "runs" / f"{key}.posteriors.npz"


def stream_path(folder: Path, digest: str) -> Path:
    """Where the stream of that digest lies."""
    return folder / "streams" / f"{digest}.npz"


def truth_path(folder: Path, key: str) -> Path:
    """Where the truth of the stream job of that key lies: never in the file that back ends are fed from."""
    return folder / "streams" / f"{key}.truth.npz"


def is_own(plugin: Plugin) -> bool:
    """Whether it comes with this package: nothing that it leaves in its process is in another job's way."""
    target = plugin.target
    while isinstance(target, functools.partial):
        target = target.func
    return "user_file" not in plugin.traits and str(target.__module__).startswith(f"{PACKAGE.name}.")
