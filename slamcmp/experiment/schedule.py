"""One round of an experiment's jobs: which runs when, and what is kept of a job that failed."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

import slamcmp.errors
from slamcmp.errors import MissingDataError, SlamcmpError, StorageError, UsageError
from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.executors import Ended, Executor
from slamcmp.experiment.job.task import Task, stream_path, truth_path
from slamcmp.experiment.job.worker import scored
from slamcmp.experiment.plan import Plan
from slamcmp.experiment.samples import Samples
from slamcmp.experiment.trials import RunJob, StreamJob, Trial
from slamcmp.metrics import score_run
from slamcmp.results.run_file import StoredRun, load_run, load_truth, run_status, save_run
from slamcmp.support.atomic import storage_error
from slamcmp.support.code_version import versions
from slamcmp.support.memory import machine_memory_mb
from slamcmp.support.progress import Watcher
from slamcmp.types import Run, Status, Trajectory

LOOK_EVERY_S = 0.1
MEMORY_SHARE = 0.9
"""Of the machine's memory that all workers together may take, where the experiment sets no limit."""


class Schedule:
    """Keeps the workers busy: a stream first, then the back ends that wait for it."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        workers: Executor,
        watcher: Watcher,
        experiment: Experiment,
        stop: threading.Event,
    ) -> None:
        self._stop = stop
        self._folder, self._workers, self._watcher = folder, workers, watcher
        self._stream_time_limit_s = experiment.stream_time_limit_s
        self._one_stream = len({trial.stream.key for trial in plan.trials}) == 1
        self._several_trials = len(plan.trials) > 1
        share = machine_memory_mb() * MEMORY_SHARE / workers.slots
        self._memory_limit_mb = experiment.memory_limit_mb or share
        self.stream_faults: dict[str, str] = {}
        self.fatal: SlamcmpError | None = None
        self.done = 0
        self._frames: dict[str, tuple[str, int]] = {}
        self._samples, self._sampled = Samples(), set[str]()
        self._trials_of: dict[str, list[Trial]] = {}
        self._names: dict[str, str] = {}
        self._waiting: dict[str, list[RunJob]] = {}
        self._ready: deque[StreamJob | RunJob] = deque(plan.streams.values())
        for trial in plan.trials:
            self._trials_of.setdefault(trial.stream.key, []).append(trial)
            self._names.setdefault(trial.stream.key, f"stream{self._suffix(trial)}")
            for job in trial.runs:
                self._names.setdefault(job.key, f"{job.back_end.label}{self._suffix(trial)}")
        for job in plan.runs.values():
            if job.stream_key in plan.streams:
                self._waiting.setdefault(job.stream_key, []).append(job)
            else:
                self._ready.append(job)
        for key in {job.stream_key for job in plan.runs.values()} - set(plan.streams):
            self._remember_stream(key)

    def run_all(self) -> None:
        """Start and finish jobs until none is left, an error concerns them all, or ``stop`` is set.

        Raises:
            StorageError: a worker could not write its result.
        """
        running = 0
        while ((self._ready and self.fatal is None) or running) and not self._stop.is_set():
            while self._ready and running < self._workers.slots and self.fatal is None:
                self._start(self._ready.popleft())
                running += 1
            for ended in self._workers.wait(LOOK_EVERY_S):
                running -= 1
                # A worker that Ctrl-C hit while it was starting has not failed.
                if not (ended.fault and self._stop.is_set()):
                    self._finish(ended)
            self._watcher.advanced(self._workers.frames_done())
            self._require_samples()

    def _require_samples(self) -> None:
        """Start nothing more where two seeds or recordings turned out to be one stream."""
        for key in self._frames.keys() - self._sampled:
            self._sampled.add(key)
            try:
                for trial in self._trials_of.get(key, ()):
                    self._samples.add(trial, self._frames[key][0])
            except UsageError as error:
                self.fatal = error

    def _suffix(self, trial: Trial) -> str:
        if not self._several_trials:
            return ""
        swept = [f"{path.rpartition('.')[2]}={value}" for path, value in trial.swept.items()]
        seed = [] if trial.seed is None else [trial.recording or f"seed {trial.seed}"]
        return f" ({', '.join([*swept, *seed])})"

    def _start(self, job: StreamJob | RunJob) -> None:
        if isinstance(job, StreamJob):
            plugins = tuple((each.spec, each.arguments()) for each in (job.source, job.front_end))
            limit = self._stream_time_limit_s
            task, frames = Task("stream", job.key, self._folder, plugins, job.seed, time_limit_s=limit), 0
        else:
            digest, frames = self._frames[job.stream_key]
            task = Task(
                "run",
                job.key,
                self._folder,
                ((job.back_end.spec, dict(job.back_end.parameters)),),
                job.seed,
                label=job.back_end.label,
                stream_key=job.stream_key,
                digest=digest,
                time_limit_s=job.time_limit_s,
                memory_limit_mb=self._memory_limit_mb,
                record=job.record,
                own_gate=job.back_end.own_gate,
            )
        try:
            task.result.unlink(missing_ok=True)
            task.online_part.unlink(missing_ok=True)
        except OSError as error:
            raise storage_error(task.result, error) from error
        self._watcher.started(task.key, self._names[task.key], frames)
        self._workers.start(task)

    def _finish(self, ended: Ended) -> None:
        task = ended.task
        if ended.storage_failed:
            raise self._storage_failure(task)
        if task.kind == "stream":
            outcome = self._finish_stream(ended)
        else:
            if ended.fault:
                self._store_failure(ended)
            elif ended.note:
                _add_note(task, ended.note)
            outcome = run_status(task.result) or "lost"
        self.done += 1
        self._watcher.ended(task.key, outcome, ended.frames_done)

    def _finish_stream(self, ended: Ended) -> str:
        key = ended.task.key
        waiting = self._waiting.pop(key, [])
        known = None if ended.fault else load_truth(ended.task.result)
        if known is not None and known.error is None:
            self._remember_stream(key)
            # Before further streams: so few streams wait unread, and results appear early.
            self._ready.extendleft(reversed(waiting))
            return "ok"
        kind, message = known.error if known is not None and known.error is not None else ("", ended.fault)
        ended.task.result.unlink(missing_ok=True)
        self.stream_faults[key] = message
        self.done += len(waiting)
        error_class = _error_class(kind)
        # A file that is not there is missing for every trial, and the fault of an only stream is all there is
        # to say. Settings that one grid point makes impossible cost that point only.
        if error_class is not None and (self._one_stream or issubclass(error_class, MissingDataError)):
            self.fatal = error_class(message)
        return message

    def _remember_stream(self, key: str) -> None:
        known = load_truth(truth_path(self._folder, key))
        assert known is not None
        self._frames[key] = known.digest, known.frames

    def _storage_failure(self, task: Task) -> StorageError:
        log = self._folder / "logs" / f"{task.key}.log"
        told = log.read_text().strip() if log.is_file() else ""
        return StorageError(
            told
            or f"cannot write {task.result}: is the disk full? What finished before is kept: "
            "make room and run the same command again"
        )

    def _store_failure(self, ended: Ended) -> None:
        """Put a row where a worker left none."""
        task = ended.task
        digest, frames = self._frames[task.stream_key]
        nothing = np.empty(0)
        place = f"after {ended.frames_done} of {frames} frames"
        status: Status = "timed_out" if ended.timed_out else "crashed"
        message = f"{place}: {ended.fault}{self._last_words(task)}"
        online_part = load_run(task.online_part)
        if online_part is not None:
            run = replace(online_part.run, status=status, message=message)
            known = load_truth(truth_path(self._folder, task.stream_key))
            save_run(scored(run, None if known is None else known.truth), task.result)
            task.online_part.unlink(missing_ok=True)
            return
        run = Run(
            back_end=task.label,
            parameters=task.plugins[0][1],
            digest=digest,
            seed=task.seed,
            frames=frames,
            status=status,
            message=message,
            online=Trajectory(nothing, np.empty((0, *self._pose_shape(task))), None),
            update_s=nothing,
            estimate_s=nothing,
            versions=versions(),
        )
        save_run(StoredRun(run, score_run(run, None), ended.frames_done / frames), task.result)

    def _pose_shape(self, task: Task) -> tuple[int, int]:
        with np.load(stream_path(self._folder, task.digest), allow_pickle=False) as file:
            size = file["prior_T"].shape[0]
        return size, size

    def _last_words(self, task: Task) -> str:
        log = self._folder / "logs" / f"{task.key}.log"
        return f"; its output is in {log}" if log.is_file() and log.stat().st_size else ""


def _error_class(name: str) -> type[SlamcmpError] | None:
    """The class of our own errors of that name."""
    found = getattr(slamcmp.errors, name, None)
    return found if isinstance(found, type) and issubclass(found, SlamcmpError) else None


def _add_note(task: Task, note: str) -> None:
    """Put what happened after the result was written into its message."""
    stored = None if task.kind == "stream" else load_run(task.result)
    if stored is not None:
        message = f"{stored.run.message}; {note}" if stored.run.message else note
        save_run(replace(stored, run=replace(stored.run, message=message)), task.result)
