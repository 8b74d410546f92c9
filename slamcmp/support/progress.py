"""Tell a person how far an experiment is: bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)


class Watcher(Protocol):
    """What the runner reports to."""

    def started(self, key: str, what: str, frames: int) -> None:
        """A job began; ``frames`` is 0 where their number is not known."""

    def advanced(self, frames_done: Mapping[str, int]) -> None:
        """Frames done by each running job."""

    def ended(self, key: str, outcome: str, frames_done: int) -> None:
        """A job is over."""


class Silent:
    """Reports nothing."""

    def started(self, key: str, what: str, frames: int) -> None: ...

    def advanced(self, frames_done: Mapping[str, int]) -> None: ...

    def ended(self, key: str, outcome: str, frames_done: int) -> None: ...


class _Unbreakable:
    """Reports to another until nothing can be told any more: a closed terminal or pipe ends no run."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher

    def started(self, key: str, what: str, frames: int) -> None:
        self._tell(lambda: self._watcher.started(key, what, frames))

    def advanced(self, frames_done: Mapping[str, int]) -> None:
        self._tell(lambda: self._watcher.advanced(frames_done))

    def ended(self, key: str, outcome: str, frames_done: int) -> None:
        self._tell(lambda: self._watcher.ended(key, outcome, frames_done))

    def _tell(self, say: Callable[[], None]) -> None:
        try:
            say()
        except (OSError, ValueError, SystemExit):
            # rich ends the program at a broken pipe.
            self._watcher = Silent()


def unbreakable(watcher: Watcher) -> Watcher:
    """The watcher, with what it cannot print left out."""
    return _Unbreakable(watcher)


class Lines:
    """One line for each job that ended."""

    def __init__(self, console: Console, jobs: int) -> None:
        self._console, self._jobs, self._done = console, jobs, 0
        self._started: dict[str, tuple[str, float]] = {}

    def started(self, key: str, what: str, frames: int) -> None:  # noqa: ARG002
        self._started[key] = (what, time.monotonic())

    def advanced(self, frames_done: Mapping[str, int]) -> None: ...

    def ended(self, key: str, outcome: str, frames_done: int) -> None:  # noqa: ARG002
        self._done += 1
        what, since = self._started.pop(key)
        seconds = time.monotonic() - since
        text = f"[{self._done}/{self._jobs}] {what}: {outcome} ({seconds:.1f} s)"
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


class Bars:
    """A bar for the whole experiment with its frames per second, and one for each running job."""

    def __init__(self, progress: Progress, jobs: int) -> None:
        self._progress = progress
        self._overall = progress.add_task("jobs", total=jobs, rate="")
        self._bars: dict[str, TaskID] = {}
        self._finished_frames = 0
        self._begin = time.monotonic()

    def started(self, key: str, what: str, frames: int) -> None:
        self._bars[key] = self._progress.add_task(what, total=frames or None, rate="")

    def advanced(self, frames_done: Mapping[str, int]) -> None:
        for key, done in frames_done.items():
            self._progress.update(self._bars[key], completed=done)
        frames = self._finished_frames + sum(frames_done.values())
        rate = f"{frames / max(time.monotonic() - self._begin, 1e-3):,.0f} frames/s"
        self._progress.update(self._overall, rate=rate)

    def ended(self, key: str, outcome: str, frames_done: int) -> None:
        bar = self._bars.pop(key)
        if outcome != "ok":
            name = self._progress.tasks[self._progress.task_ids.index(bar)].description
            self._progress.console.print(f"{name}: {outcome}", markup=False, soft_wrap=True)
        self._finished_frames += frames_done
        self._progress.remove_task(bar)
        self._progress.advance(self._overall)


@contextlib.contextmanager
def watching(
    jobs: int,
    *,
    show: bool,
    bars: Callable[[Progress, int], Watcher] = Bars,
    further: Sequence[ProgressColumn] = (TextColumn("{task.fields[rate]}"),),
) -> Iterator[Watcher]:
    """The watcher that fits where standard error leads.

    Args:
        jobs: how many there will be.
        show: otherwise nothing is reported.
        bars: makes the watcher of a terminal.
        further: columns of its bars behind name, bar, count and time.
    """
    console = Console(stderr=True)
    if not show or not jobs:
        yield Silent()
    elif not console.is_terminal:
        yield Lines(console, jobs)
    else:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            *further,
        )
        progress = Progress(*columns, console=console, transient=True)
        # The terminal may be gone at either end.
        with contextlib.suppress(OSError, SystemExit):
            progress.start()
        try:
            yield bars(progress, jobs)
        finally:
            with contextlib.suppress(OSError, SystemExit):
                progress.stop()
