"""Results that all experiments of a user share: equal key, equal result, whichever folder computed it.

The cache looks like a results folder: ``runs/``, ``streams/`` and ``logs/`` with the same names, which are
the keys of content_key.py. A result is brought into a results folder before the work is planned, and kept
after it is done; everything between knows the results folder alone, and looks at what was brought as at its
own: a run whose unlisted inputs have changed is made anew. Files are hard links where both folders lie on one
file system, which cost no room as long as the results folder is there: nothing ever writes into an old one.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from slamcmp.errors import StorageError
from slamcmp.experiment.job.task import posteriors_path, run_path, stream_path, truth_path
from slamcmp.experiment.planning.trials import Trial
from slamcmp.registry import SESSION
from slamcmp.results.runs.run_file import StoredTruth, load_run, load_truth, truth_digest
from slamcmp.support.files.packed_files import names_in

VARIABLE = "SLAMCMP_CACHE"
OFF = ("off", "0", "no", "")
LIMIT_BYTES = 4 << 30
"""What the cache may hold; above it the results that were not used for longest go."""
KEPT_SHARE = 0.8
"""Of the limit that is left then: not every run has to look for what to remove."""
DETERMINED = ("ok", "diverged")
"""Statuses that the key decides; how a run ended otherwise may be the machine's doing."""
_ROOMS = ("runs", "streams", "logs")


def cache_folder() -> Path | None:
    """Where the shared cache is: ``SLAMCMP_CACHE``, else ``slamcmp`` in XDG_CACHE_HOME or ``~/.cache``.

    None where SLAMCMP_CACHE is ``off`` (or empty), or there is no home.
    """
    named = os.environ.get(VARIABLE)
    if named is not None:
        return None if named.strip().lower() in OFF else Path(named).expanduser().absolute()
    # A relative one is to be ignored (XDG Base Directory Specification 0.8).
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "slamcmp"
    except RuntimeError:
        return None


@dataclass(frozen=True)
class CacheContent:
    """What a cache holds."""

    runs: int
    streams: int
    size_bytes: int


class SharedCache:
    """The results of all experiments, by key.

    Args:
        folder: its root; made when something is kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def bring(self, trials: Sequence[Trial], folder: Path) -> set[str]:
        """Put into a results folder what the cache knows of these trials and the folder does not.

        Returns:
            The keys of the runs that were brought. What cannot be read is as if it were not there.
        """
        runs, streams = _names(self.folder / "runs"), _names(self.folder / "streams")
        if not (runs or streams):
            return set()
        runs_there, streams_there = names_in(folder / "runs"), names_in(folder / "streams")
        brought: set[str] = set()
        seen: set[str] = set()
        for trial in trials:
            key = trial.stream.key
            truth_name = truth_path(folder, key).name
            if key not in seen and truth_name not in streams_there and truth_name in streams:
                self._bring_stream(key, folder)
            seen.add(key)
            known: StoredTruth | None = None
            for job in trial.runs:
                name = run_path(folder, job.key).name
                if job.key in seen or name in runs_there or name not in runs:
                    continue
                seen.add(job.key)
                known = known or _truth(truth_path(folder, key))
                if known is not None and self._bring_run(job.key, known, folder):
                    brought.add(job.key)
        return brought

    def offers(self, keys_of_runs: Iterable[str]) -> int:
        """How many of these runs it has, by their names alone."""
        there = _names(self.folder / "runs")
        return sum(run_path(self.folder, key).name in there for key in keys_of_runs)

    def keep(self, keys_of_streams: Iterable[str], keys_of_runs: Iterable[str], folder: Path) -> None:
        """Take over what a results folder has of these keys; a cache that cannot be written is left alone.

        What a large sweep has packed already stays with it.
        """
        kept = False
        with contextlib.suppress(OSError):
            for key in keys_of_streams:
                known = _truth(truth_path(folder, key))
                if known is not None and known.error is None:
                    kept |= _link(stream_path(folder, known.digest), stream_path(self.folder, known.digest))
                    kept |= _link(truth_path(folder, key), truth_path(self.folder, key))
            for key in keys_of_runs:
                # Of what a notebook defined nobody can ask for again.
                if not key.startswith(f"{SESSION}-"):
                    # The run last: where it is, what belongs to it is there too.
                    _link(_log_path(folder, key), _log_path(self.folder, key))
                    _link(posteriors_path(folder, key), posteriors_path(self.folder, key))
                    kept |= _link(run_path(folder, key), run_path(self.folder, key))
            if kept:
                self._make_room(LIMIT_BYTES)

    def content(self) -> CacheContent:
        """What it holds."""
        files = list(self._files())
        runs = sum(
            path.parent.name == "runs" and not path.name.endswith(".posteriors.npz") for path, _ in files
        )
        streams = sum(path.name.endswith(".truth.npz") for path, _ in files)
        return CacheContent(runs, streams, sum(status.st_size for _, status in files))

    def clear(self) -> CacheContent:
        """Remove all that it holds, and nothing else that lies in its folder.

        Returns:
            What it held.

        Raises:
            StorageError: a file cannot be removed.
        """
        held = self.content()
        for path, _ in self._files():
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise StorageError(f"cannot remove {path}: {error.strerror or error}") from error
        for room in (*(self.folder / each for each in _ROOMS), self.folder):
            with contextlib.suppress(OSError):
                room.rmdir()
        return held

    def _bring_stream(self, key: str, folder: Path) -> None:
        """The truth of a stream job, and the stream."""
        cached = truth_path(self.folder, key)
        known = _truth(cached)
        if known is None or known.error is not None:
            return
        with contextlib.suppress(OSError):
            _link(stream_path(self.folder, known.digest), stream_path(folder, known.digest))
            _link(cached, truth_path(folder, key))
            _used(cached, stream_path(self.folder, known.digest))

    def _bring_run(self, key: str, known: StoredTruth, folder: Path) -> bool:
        """One run, if it is of this very stream and was scored against this very truth."""
        cached = run_path(self.folder, key)
        try:
            stored = load_run(cached)
        except MemoryError:
            return False
        if stored is None or stored.run.status not in DETERMINED:
            return False
        if (stored.run.digest, stored.scored_against) != (known.digest, truth_digest(known.truth)):
            return False
        with contextlib.suppress(OSError):
            _link(posteriors_path(self.folder, key), posteriors_path(folder, key))
            _link(_log_path(self.folder, key), _log_path(folder, key))
            done = _link(cached, run_path(folder, key))
            _used(cached, posteriors_path(self.folder, key), _log_path(self.folder, key))
            return done
        return False

    def _make_room(self, limit_bytes: int) -> None:
        files = sorted(self._files(), key=lambda each: each[1].st_mtime)
        size = sum(status.st_size for _, status in files)
        if size <= limit_bytes:
            return
        for path, status in files:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
                size -= status.st_size
            if size <= KEPT_SHARE * limit_bytes:
                return

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        for room in _ROOMS:
            with contextlib.suppress(OSError), os.scandir(self.folder / room) as entries:
                for entry in entries:
                    if not entry.name.endswith((".npz", ".log")):
                        continue
                    with contextlib.suppress(OSError):
                        yield Path(entry.path), entry.stat(follow_symlinks=False)


def shared_cache() -> SharedCache | None:
    """The user's, or None where it is turned off."""
    folder = cache_folder()
    return None if folder is None else SharedCache(folder)


def _truth(path: Path) -> StoredTruth | None:
    try:
        return load_truth(path)
    except MemoryError:
        return None


def _log_path(folder: Path, key: str) -> Path:
    return folder / "logs" / f"{key}.log"


def _names(folder: Path) -> Collection[str]:
    try:
        return frozenset(os.listdir(folder))
    except OSError:
        return frozenset()


def _used(*paths: Path) -> None:
    """What was asked for last goes last."""
    for path in paths:
        with contextlib.suppress(OSError):
            os.utime(path)


def _link(source: Path, target: Path) -> bool:
    """Have ``source`` as ``target`` as well, whatever was there; False where there is no source.

    Raises:
        OSError: the target cannot be written.
    """
    if not source.is_file():
        return False
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        try:
            os.link(source, temporary)
        except OSError:
            # Another file system, or one without links.
            shutil.copyfile(source, temporary)
        temporary.replace(target)
    finally:
        # rename does nothing where both are the same file already.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return True
