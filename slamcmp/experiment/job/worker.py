"""What a job does, in whichever process it runs: read its input files, compute, write its result file."""

from __future__ import annotations

import contextlib
import sys
import time
import traceback
from collections.abc import Mapping, MutableSequence, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

from slamcmp.backends.own_gate import OwnGate
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.record import Record
from slamcmp.experiment.job.recorder import Recorder
from slamcmp.experiment.job.run_back_end import describe, run_back_end
from slamcmp.frontend.stream_file import load_stream, save_stream
from slamcmp.metrics import score_run
from slamcmp.protocols import BackEnd
from slamcmp.registry import Plugin, back_ends, front_ends, sources
from slamcmp.results.posteriors import save_posteriors
from slamcmp.results.run_file import StoredRun, StoredTruth, load_truth, save_run, save_truth
from slamcmp.support.plugin_models import bind_parameters
from slamcmp.types import CameraFrame, GroundTruth, Log, MeasurementStream, Problem, Run, Status


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

    @property
    def result(self) -> Path:
        """The file that this job leaves."""
        return (truth_path if self.kind == "stream" else run_path)(self.folder, self.key)

    @property
    def online_part(self) -> Path:
        """What a run leaves when its frames are done, for the case that it does not come to its end."""
        return self.result.with_name(f".{self.key}.online.npz")


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


def perform(task: Task, heartbeat: MutableSequence[float]) -> None:
    """Do one job.

    Raises:
        StorageError: the result cannot be written. Everything else becomes part of the result.
    """
    # OpenCV is not imported here: only where a front end or a source has loaded it is there a pool to stop.
    cv2 = sys.modules.get("cv2")
    if cv2 is not None:
        cv2.setNumThreads(1)
    if task.kind == "stream":
        heartbeat[0] = time.monotonic()
        _make_stream(task, heartbeat)
    else:
        _run(task, heartbeat)


def make_stream(
    source: tuple[str, Mapping[str, Any]],
    front_end: tuple[str, Mapping[str, Any]],
    seed: int | None,
    heartbeat: MutableSequence[float] | None = None,
) -> tuple[MeasurementStream, Log]:
    """The stream that a source and a front end, each (name, parameters), make from a seed; and its log.

    ``heartbeat[1]`` is set to the images taken so far.
    """
    seed = 0 if seed is None else seed
    plugin = sources.get(source[0])
    log: Log = plugin.target(seed, **bind_parameters(plugin, dict(source[1])))
    if log.images is not None and heartbeat is not None:
        log = replace(log, images=_Counted(log.images, heartbeat))
    plugin = front_ends.get(front_end[0])
    stream: MeasurementStream = plugin.target(log, seed, **bind_parameters(plugin, dict(front_end[1])))
    return stream, log


class _Counted(Sequence[CameraFrame]):
    """Images that tell how many of them were asked for: making a stream of images takes a while."""

    def __init__(self, images: Sequence[CameraFrame], heartbeat: MutableSequence[float]) -> None:
        self._images, self._heartbeat = images, heartbeat

    def __len__(self) -> int:
        return len(self._images)

    @overload
    def __getitem__(self, k: int) -> CameraFrame: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[CameraFrame]: ...
    def __getitem__(self, k: int | slice) -> CameraFrame | Sequence[CameraFrame]:
        self._heartbeat[1] += 1
        return self._images[k]


def _make_stream(task: Task, heartbeat: MutableSequence[float]) -> None:
    try:
        stream, log = make_stream(task.plugins[0], task.plugins[1], task.seed, heartbeat)
    except Exception as error:
        text = str(error) if isinstance(error, SlamcmpError) else describe(error)
        save_truth(StoredTruth("", 0, None, {}, (type(error).__name__, text)), task.result)
        return
    save_stream(stream, stream_path(task.folder, stream.digest))
    truth = truth_of_stream(log.truth, stream)
    totals = {} if stream.report is None else stream.report.totals()
    if log.truth is not None and truth is not None and truth.outliers is not None:
        for name, masks in (("outliers", log.truth.outliers), ("outliers kept", truth.outliers)):
            totals[name] = sum(int(mask.sum()) for mask in masks or ())
    known = StoredTruth(stream.digest, len(stream.frames), truth, totals, warnings=log.warnings)
    save_truth(known, task.result)


def truth_of_stream(truth: GroundTruth | None, stream: MeasurementStream) -> GroundTruth | None:
    """A log's truth with its ``outliers`` over the stream's observations.

    They are None where the front end does not say which detections it kept.
    """
    if truth is None or truth.outliers is None:
        return truth
    outliers = None
    if stream.report is not None:
        kept = stream.report.kept
        fits = [mask.size == each.size for mask, each in zip(truth.outliers, kept, strict=True)]
        if all(fits):
            outliers = tuple(mask[each] for mask, each in zip(truth.outliers, kept, strict=True))
    return replace(truth, outliers=outliers)


def _run(task: Task, heartbeat: MutableSequence[float]) -> None:
    stream = load_stream(stream_path(task.folder, task.digest))
    ((spec, parameters),) = task.plugins
    plugin = back_ends.get(spec)
    bound = bind_parameters(plugin, dict(parameters))
    recorder = None if task.record is None else Recorder(task.record, len(stream.frames))

    def make(problem: Problem) -> BackEnd:
        made = _make_back_end(plugin, problem, bound, task)
        return made if recorder is None else recorder.begin(made)

    run = run_back_end(
        make,
        stream,
        label=task.label,
        parameters=parameters,
        seed=task.seed,
        time_limit_s=task.time_limit_s,
        heartbeat=heartbeat,
        on_frames_done=lambda online: save_run(StoredRun(online, {}, 1.0), task.online_part),
        after_frame=None if recorder is None else recorder.after_frame,
    )
    if recorder is not None and recorder.posteriors:
        save_posteriors(recorder.posteriors, posteriors_path(task.folder, task.key))
    # Only now: while the back end runs, the truth is not in its process, unless it asks for it by its trait.
    save_run(scored(run, _truth(task)), task.result)
    task.online_part.unlink(missing_ok=True)


def scored(run: Run, truth: GroundTruth | None) -> StoredRun:
    """The run with its scores; where they cannot be computed, a crashed one that keeps its online part."""
    try:
        return StoredRun(run, score_run(run, truth), run.completion)
    except Exception as error:
        traceback.print_exc()
        told = f"{run.message}; " if run.message else ""
        status: Status = "crashed" if run.status == "ok" else run.status
        message = f"{told}it could not be scored: {describe(error)}"
    online = replace(run, status=status, message=message, final=None, landmarks=None, joint_covariance=None)
    scores: dict[str, float] = {}
    # Most faults lie in what was just left out.
    with contextlib.suppress(Exception):
        scores = score_run(online, truth)
    return StoredRun(online, scores, run.completion)


def _make_back_end(plugin: Plugin, problem: Problem, bound: Mapping[str, Any], task: Task) -> BackEnd:
    """A new back end, with ``needs_truth`` told the truth as well, and behind its own gate if it has one.

    Raises:
        UsageError: it needs the truth and the log has none, or cannot gate for itself.
    """
    arguments: list[Any] = [problem]
    if plugin.traits.get("needs_truth"):
        truth = _truth(task)
        if truth is None:
            raise UsageError(f"{plugin.name} needs the truth, and this source's log has none")
        arguments.append(truth)
    made: BackEnd = plugin.target(*arguments, **bound)
    return made if task.own_gate is None else OwnGate(made, problem, task.own_gate)


def _truth(task: Task) -> GroundTruth | None:
    stored = load_truth(truth_path(task.folder, task.stream_key))
    return None if stored is None else stored.truth
