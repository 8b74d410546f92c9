"""What a job does, in whichever process it runs: read its input files, compute, write its result file."""

from __future__ import annotations

import contextlib
import sys
import time
import traceback
from collections.abc import Mapping, MutableSequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from slamcmp.backends.own_gate import OwnGate
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.job.make_stream import store_stream
from slamcmp.experiment.job.planned import held_to_plan, inputs, require_unchanged
from slamcmp.experiment.job.recorder import Recorder
from slamcmp.experiment.job.run_back_end import run_back_end
from slamcmp.experiment.job.task import Task, posteriors_path, stream_path, truth_path
from slamcmp.frontend.stream_file import load_stream
from slamcmp.metrics import score_run
from slamcmp.protocols import BackEnd
from slamcmp.registry import Plugin, back_ends
from slamcmp.results.runs.posteriors import save_posteriors
from slamcmp.results.runs.run_file import StoredRun, load_truth, save_run, truth_digest
from slamcmp.support.configuration.plugin_models import bind_parameters
from slamcmp.support.messages import describe, told
from slamcmp.support.provenance.code_version import stamp
from slamcmp.support.shared_arrays import SharedArrays
from slamcmp.types import GroundTruth, MeasurementStream, Problem, Run, Status


class LostStreamError(Exception):
    """The file of the stream that a run is to be fed from is gone, or not what it was."""


def perform(task: Task, heartbeat: MutableSequence[float], shared: SharedArrays | None = None) -> bool:
    """Do one job; ``shared`` keeps what a run has done in case this process does not come to its end.

    Answers whether all went well, so that this process is as good as new.

    Raises:
        StorageError: the result cannot be written.
        OutdatedError: what was loaded or read is not what the result would be named by.
        LostStreamError: the stream of a run cannot be read. Everything else becomes part of the result.
    """
    # OpenCV is not imported here: only where a front end or a source has loaded it is there a pool to stop.
    cv2 = sys.modules.get("cv2")
    if cv2 is not None:
        cv2.setNumThreads(1)
    if task.kind == "stream":
        heartbeat[0] = time.monotonic()
        stream = store_stream(task, heartbeat)
        if stream is not None and task.shares_process:
            AT_HAND.keep(stream, stream_path(task.folder, stream.digest))
        return stream is not None
    return _run(task, heartbeat, shared) == "ok"


class StreamAtHand:
    """The last stream of a process that does several jobs, as long as its file is what it was."""

    def __init__(self) -> None:
        self._stream: MeasurementStream | None = None
        self._file: Path | None = None
        self._stamp: tuple[int, ...] = ()

    def keep(self, stream: MeasurementStream, file: Path) -> None:
        """Remember a stream that was just written to a file or read from it."""
        with contextlib.suppress(OSError):
            self._stream, self._file, self._stamp = stream, file, stamp(file)

    def load(self, file: Path) -> MeasurementStream:
        """The stream of that file.

        Raises:
            SlamcmpError: it is gone, or damaged.
        """
        with contextlib.suppress(OSError):
            if self._stream is not None and self._file == file and self._stamp == stamp(file):
                return self._stream
        stream = load_stream(file)
        self.keep(stream, file)
        return stream


AT_HAND = StreamAtHand()


def _run(task: Task, heartbeat: MutableSequence[float], shared: SharedArrays | None) -> Status:
    with held_to_plan(task) as opened:
        file = stream_path(task.folder, task.digest)
        try:
            stream = AT_HAND.load(file) if task.shares_process else load_stream(file)
        except SlamcmpError as error:
            # A damaged one too: the same command then makes it again.
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)
            raise LostStreamError(told(str(error))) from error
        ((spec, parameters),) = task.plugins
        counted = opened.reads.counted if task.watched else contextlib.nullcontext
        with counted():
            plugin = back_ends.get(spec)
        bound = bind_parameters(plugin, dict(parameters))
        recorder = None if task.record is None else Recorder(task.record, len(stream.frames))

        def make(problem: Problem) -> BackEnd:
            _require_use_of_relative_poses(plugin, stream)
            made = _make_back_end(plugin, problem, bound, task)
            return made if recorder is None else recorder.begin(made)

        with counted():
            run = run_back_end(
                make,
                stream,
                label=task.label,
                parameters=parameters,
                seed=task.seed,
                time_limit_s=task.time_limit_s,
                heartbeat=heartbeat,
                shared=shared,
                after_frame=None if recorder is None else recorder.after_frame,
            )
    if run.status != "ok":
        require_unchanged(task)
    if recorder is not None and recorder.posteriors:
        save_posteriors(recorder.posteriors, posteriors_path(task.folder, task.key))
    # Only now: while the back end runs, the truth is not in its process, unless it asks for it by its trait.
    stored = replace(scored(run, _truth(task)), inputs=inputs(task, opened), timed_alone=task.alone)
    save_run(stored, task.result)
    return run.status


def scored(run: Run, truth: GroundTruth | None) -> StoredRun:
    """The run with its scores; where they cannot be computed, a crashed one that keeps its online part."""
    return replace(_scored(run, truth), scored_against=truth_digest(truth))


def _scored(run: Run, truth: GroundTruth | None) -> StoredRun:
    try:
        return StoredRun(run, score_run(run, truth), run.completion)
    except Exception as error:
        traceback.print_exc()
        before = f"{run.message}; " if run.message else ""
        status: Status = "crashed" if run.status == "ok" else run.status
        message = told(f"{before}it could not be scored: {describe(error)}")
    online = replace(run, status=status, message=message, final=None, landmarks=None, joint_covariance=None)
    scores: dict[str, float] = {}
    # Most faults lie in what was just left out.
    with contextlib.suppress(Exception):
        scores = score_run(online, truth)
    return StoredRun(online, scores, run.completion)


def _require_use_of_relative_poses(plugin: Plugin, stream: MeasurementStream) -> None:
    """Raise UsageError for a stream with loop closures between poses that the back end would leave out."""
    if getattr(plugin.target, "relative_poses", None) is not None:
        return
    for frame in stream.frames:
        if frame.relative_poses is not None:
            raise UsageError(
                f"{plugin.name} takes no loop closures between poses (frame {frame.k} is related to frame "
                f"{frame.relative_poses.frames[0]}): take a smoother (isam2, batch; fixed_lag within "
                "its lag), or "
                "set the source's closures to 'places', which replaces them by sights of places for "
                "every back end"
            )


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
