"""One job on another machine: its files come with it, and its results go back as bytes.

What a job does there it does in a worker process of its own below this one, as on the user's machine
(processes.py): with the same limits, and what ends it ends nothing else.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import shutil
import tempfile
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from slamcmp.experiment.executors.processes import LOOK_EVERY_S, Processes
from slamcmp.experiment.job.collected import recovered
from slamcmp.experiment.job.task import Task, stream_path, truth_path
from slamcmp.experiment.job.worker import scored
from slamcmp.results.runs.run_file import load_truth, save_run
from slamcmp.support.provenance.code_version import PACKAGE, file_digest, stamp, version_of
from slamcmp.types import Status

_PLACES = threading.local()
_START = threading.Lock()


@dataclass(frozen=True)
class Sent:
    """What comes back."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    """By their names in the results folder; the job's own result is the last."""
    fault: str = ""
    status: Status = "crashed"
    outdated: bool = False
    frames_done: int = 0
    note: str = ""
    not_here: bool = False
    """Files that the job names are not on this machine, or are others."""


def package_version() -> str:
    """By the text of all of slamcmp."""
    files = sorted(PACKAGE.rglob("*.py"))
    return version_of({str(path): file_digest(path) for path in files})


def do(task: Task, expected: str, frames: int, *inputs: Sent | Mapping[str, bytes]) -> Sent:
    """Do a job here; ``inputs`` hold the files that it reads, ``frames`` is how many its stream has."""
    if package_version() != expected:
        fault = "another version of slamcmp is installed where it was to run"
        return Sent(fault=fault, status="missing")
    if not _is_as_planned(task):
        return Sent(not_here=True)
    root = Path(tempfile.mkdtemp(prefix="slamcmp-job-"))
    try:
        for each in inputs:
            for name, content in (each.files if isinstance(each, Sent) else each).items():
                path = root / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        return _done(_at_home(task, root), frames)
    finally:
        shutil.rmtree(root, ignore_errors=True)


def for_elsewhere(task: Task) -> Task:
    """The task with paths of the package as from its folder up: it lies elsewhere on other machines."""
    root = PACKAGE.parent
    code = {
        Path(path).relative_to(root).as_posix() if Path(path).is_relative_to(PACKAGE) else path: digest
        for path, digest in task.code.items()
    }
    return replace(task, code=code)


def _at_home(task: Task, root: Path) -> Task:
    """The task with this machine's paths of the package."""
    # An absolute path stays what it is.
    return replace(
        task, folder=root, code={str(PACKAGE.parent / path): digest for path, digest in task.code.items()}
    )


def _is_as_planned(task: Task) -> bool:
    """Whether the user's files and the data are here, and what they were."""
    try:
        users = [Path(path) for path in task.code if Path(path).is_absolute()]
        code = all(file_digest(path) == task.code[str(path)] for path in users)
        return code and all(stamp(Path(path)) == tuple(known) for path, known in task.data.items())
    except OSError:
        return False


def _done(task: Task, frames: int) -> Sent:
    place = _place()
    with _START, _may_have_children():
        place.start(task)
    while not (found := place.wait(LOOK_EVERY_S)):
        pass
    (ended,) = found
    if ended.shared is not None:
        if ended.fault and ended.status != "missing" and not ended.storage_failed:
            known = load_truth(truth_path(task.folder, task.stream_key))
            run = recovered(
                ended.shared,
                ended.frames_done,
                label=task.label,
                parameters=task.plugins[0][1],
                digest=task.digest,
                seed=task.seed,
                frames=frames,
                status=ended.status,
                message=f"after {ended.frames_done} of {frames} frames: {ended.fault}",
            )
            stored = scored(run, None if known is None else known.truth)
            save_run(replace(stored, completion=ended.frames_done / frames), task.result)
        ended.shared.close()
    has_result = task.result.is_file()
    fault = "" if has_result else ended.fault or "it left no result"
    if ended.storage_failed:
        fault = f"no room where it ran: {ended.fault}"
    return Sent(
        _files(task),
        fault,
        "missing" if ended.storage_failed else ended.status,
        ended.outdated,
        ended.frames_done,
        ended.note,
    )


def _files(task: Task) -> dict[str, bytes]:
    """All that the job left, its result last."""
    found: dict[str, bytes] = {}
    left = [task.log, task.folder / "runs" / f"{task.key}.posteriors.npz"]
    known = load_truth(task.result) if task.kind == "stream" and task.result.is_file() else None
    if known is not None:
        left.append(stream_path(task.folder, known.digest))
    for path in (*left, task.result):
        with contextlib.suppress(OSError):
            found[path.relative_to(task.folder).as_posix()] = path.read_bytes()
    return found


def _place() -> Processes:
    """Of this thread: its workers stay for the next job."""
    if not hasattr(_PLACES, "processes"):
        with _START:
            _PLACES.processes = Processes(slots=1)
    place: Processes = _PLACES.processes
    return place


@contextlib.contextmanager
def _may_have_children() -> Iterator[None]:
    """A process that is a daemon of another's may not start any by itself; ours end with it."""
    configuration: dict[str, Any] = getattr(multiprocessing.current_process(), "_config", {})
    before = configuration.get("daemon")
    configuration["daemon"] = False
    try:
        yield
    finally:
        configuration["daemon"] = before
