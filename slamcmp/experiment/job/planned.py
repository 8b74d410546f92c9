"""Hold a job to what its key names: the code that it loaded and the data that it read are those planned."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from slamcmp.experiment.job.task import Task
from slamcmp.loaded_code import imported_libraries, loaded_digests
from slamcmp.support.provenance.code_version import PACKAGE, foreign_imports, stamp
from slamcmp.support.provenance.opened_files import UNKNOWN, OpenedFiles, watched

SEEN = frozenset({"numpy", "scipy", "slamcmp"})
"""Libraries that open files through Python, which tells of it."""
MAPPERS = frozenset({"polars", "pyarrow", "netCDF4", "tables", "torch", "zarr"})
"""Libraries that map files into memory and let them go: no counter counts what is read so."""


class OutdatedError(Exception):
    """What this process loaded or read is not what the result would be named by."""


@contextmanager
def held_to_plan(task: Task) -> Iterator[OpenedFiles]:
    """Watch what is read; before and after, hold the loaded code to the planned one.

    Raises:
        OutdatedError: they differ, or a planned file changed while something failed.
    """
    _require_planned(task)
    opened = OpenedFiles((task.folder,))
    try:
        if task.watched:
            with watched(opened):
                yield opened
        else:
            yield opened
    except Exception:
        # A file that is just being written may be why.
        require_unchanged(task)
        raise
    _require_planned(task)


def _require_planned(task: Task) -> None:
    loaded = loaded_digests()
    for path, digest in task.code.items():
        if loaded.get(path, digest) != digest:
            raise OutdatedError(path)
    for path in task.data:
        if changed_stamp(task, path):
            raise OutdatedError(path)


def changed_stamp(task: Task, path: str) -> bool:
    """Whether a declared data file is not any more what it was when it was hashed."""
    return _stamp(path) != tuple(task.data[path])


def loaded_before(code: Mapping[str, str]) -> list[str]:
    """The names of the files that this very process runs an older text of."""
    loaded = loaded_digests()
    return sorted(
        os.path.basename(path) for path, digest in code.items() if loaded.get(path, digest) != digest
    )


def require_unchanged(task: Task) -> None:
    """Hold the users' files as they are now to what was planned, whether loaded or not.

    Raises:
        OutdatedError: one of them has changed.
    """
    for path, digest in task.code.items():
        if not Path(path).is_relative_to(PACKAGE) and digest_now(path) != digest:
            raise OutdatedError(path)


def inputs(task: Task, opened: OpenedFiles) -> dict[str, str]:
    """What a result depends on beside what its key names: digests by path."""
    if not task.watched:
        return {}
    found = opened.inputs(task.code)
    # In a process that does more than one job, what the others loaded is none of this one's.
    folders = [Path(path).parent for path in task.code if not Path(path).is_relative_to(PACKAGE)]
    for path, digest in loaded_digests().items():
        near = any(Path(path).is_relative_to(folder) for folder in folders)
        if path not in task.code and (near or opened.loaded_before.get(path) != digest):
            found[path] = digest
    found = {path: digest for path, digest in found.items() if not Path(path).is_relative_to(PACKAGE)}
    unseen = unseen_readers(task, opened)
    if unseen:
        found[UNKNOWN] = unseen
    return found


def unseen_readers(task: Task, opened: OpenedFiles) -> str:
    """What may have read files for a user's plug-in without anybody seeing it; empty where nothing did.

    The bytes are counted, so that one that only computes with a library costs no result; where nobody could
    count, what it imports tells.
    """
    if all(task.declared):
        return ""
    own = [Path(path) for path in task.code if not Path(path).is_relative_to(PACKAGE)]
    named = {name for path in own for name in foreign_imports(path)}
    named |= {name for path in own for name in imported_libraries(path.parent)}
    libraries = sorted(named - SEEN)
    if opened.calls_c:
        libraries.append("a C library")
    # What was loaded before, in a process that does more than one job, nobody counted.
    fresh = not any(str(path) in opened.loaded_before for path in own)
    if fresh and opened.reads.nothing and MAPPERS.isdisjoint(libraries):
        libraries = []
    elif not libraries and opened.sizes_known and opened.reads.more_than_told:
        # A library that no import statement names.
        libraries = ["a library in C"]
    return ", ".join([*libraries, *opened.unseen])


def digest_now(path: str) -> str:
    """sha256 of a file's text; empty where it is gone."""
    import hashlib

    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""


def _stamp(path: str) -> tuple[int, ...]:
    try:
        return stamp(Path(path))
    except OSError:
        return ()


def changed_files(code: Mapping[str, str]) -> list[str]:
    """The names of the files that are not any more what they were when the job was planned."""
    return sorted(os.path.basename(path) for path, digest in code.items() if digest_now(path) != digest)
