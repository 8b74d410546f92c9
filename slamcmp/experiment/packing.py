"""Puts the files of finished jobs together while others run: a large sweep leaves few files behind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from slamcmp.experiment.job.task import Task
from slamcmp.experiment.planning.trials import RunJob
from slamcmp.support.files.packed_files import packed_files

PACK_FILES = 2048
"""Files that lie about before they are put together."""


class Packing:
    """Knows which streams no run waits for any more.

    Args:
        folder: the results folder.
        runs: that are to be done.
    """

    def __init__(self, folder: Path, runs: Iterable[RunJob]) -> None:
        self._folder = folder
        self._left = Counter(job.stream_key for job in runs)
        self._files: dict[str, list[str]] = {}
        self._ready: list[str] = []

    def stream_done(self, key: str, digest: str) -> None:
        """A stream was made."""
        self._files[key] = [f"streams/{key}.truth.npz", f"streams/{digest}.npz"]

    def run_done(self, task: Task) -> None:
        """A run came to its end.

        Raises:
            StorageError: the disk is full; all files are where they were.
        """
        own = self._files.setdefault(task.stream_key, [])
        own.append(f"runs/{task.key}.npz")
        self._left[task.stream_key] -= 1
        if self._left[task.stream_key] > 0:
            return
        self._ready += self._files.pop(task.stream_key)
        if len(self._ready) >= PACK_FILES:
            packed_files(self._folder).pack(self._ready)
            self._ready = []
