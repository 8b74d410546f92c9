"""Tell a person how far a class run is: a bar with the time that is left, plain lines without a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager

from rich.progress import Progress, TextColumn, TimeRemainingColumn

from slamcmp.support.progress import Watcher, watching


def class_watcher(gradings: int, *, show: bool) -> AbstractContextManager[Watcher]:
    """The watcher that fits where standard error leads."""
    further = (TimeRemainingColumn(), TextColumn("{task.fields[current]}", markup=False))
    return watching(gradings, show=show, bars=_Bar, further=further)


class _Bar:
    """One bar for the class, with who is being graded behind it."""

    def __init__(self, progress: Progress, gradings: int) -> None:
        self._progress = progress
        self._current: dict[str, str] = {}
        self._bar = progress.add_task("grading", total=gradings, current="")

    def started(self, key: str, what: str, frames: int) -> None:  # noqa: ARG002
        self._current[key] = what
        self._tell()

    def advanced(self, frames_done: Mapping[str, int]) -> None: ...

    def ended(self, key: str, outcome: str, frames_done: int) -> None:  # noqa: ARG002
        student = self._current.pop(key)
        if outcome != "ok":
            self._progress.console.print(f"{student}: {outcome}", markup=False, soft_wrap=True)
        self._progress.advance(self._bar)
        self._tell()

    def _tell(self) -> None:
        self._progress.update(self._bar, current=", ".join(self._current.values())[:60])
