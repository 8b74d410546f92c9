"""Jobs of plug-ins that only this process has, beside worker processes for all others."""

from __future__ import annotations

from collections.abc import Collection

from slamcmp.experiment.executors.processes import Ended, Processes, Serial
from slamcmp.experiment.job.task import Task
from slamcmp.registry import SESSION, executors


@executors.register(SESSION, in_process=True)
class Session:
    """A class of a notebook's cell runs in this process, everything else in worker processes.

    No other process can import such a class. Here it has no memory limit, its time limit is only looked at
    between frames, and while it runs nobody looks after the workers: theirs are noticed late.
    """

    def __init__(self, *, slots: int = 1) -> None:
        self.slots = slots
        self._here = Serial()
        self._elsewhere = Processes(slots=slots)

    def start(self, task: Task) -> None:
        known_here_only = task.kind == "run" and task.plugins[0][0].startswith(f"{SESSION}:")
        (self._here if known_here_only else self._elsewhere).start(task)

    def wait(self, timeout_s: float) -> list[Ended]:
        return self._here.wait(0.0) or self._elsewhere.wait(timeout_s)

    def frames_done(self) -> dict[str, int]:
        return self._elsewhere.frames_done()

    def at_hand(self) -> Collection[str]:
        return self._elsewhere.at_hand()

    def close(self) -> None:
        self._elsewhere.close()
        self._here.close()
