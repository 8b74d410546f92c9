"""One round of an experiment's jobs: which runs when, and what is kept of a job that failed."""

from __future__ import annotations

import contextlib
import io
import threading
from collections import deque
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

import slamcmp.errors
from slamcmp.errors import MissingDataError, SlamcmpError, StorageError, UsageError
from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.executors.processes import Ended, Executor, ExecutorLostError
from slamcmp.experiment.job.collected import recovered
from slamcmp.experiment.job.fault import OUTSIDE, Fault
from slamcmp.experiment.job.outdated import why_outdated
from slamcmp.experiment.job.task import Task, is_own, run_path, stream_path, truth_path
from slamcmp.experiment.job.worker import scored
from slamcmp.experiment.packing import Packing
from slamcmp.experiment.planning.plan import Plan
from slamcmp.experiment.planning.samples import Samples
from slamcmp.experiment.planning.trials import RunJob, StreamJob, Trial
from slamcmp.frontend.stream_file import load_stream
from slamcmp.registry import Plugin
from slamcmp.results.grid import point_name
from slamcmp.results.runs.run_file import StoredTruth, load_run, load_truth, save_run, truth_digest
from slamcmp.support.files.atomic import storage_error
from slamcmp.support.files.packed_files import content, remove
from slamcmp.support.memory import machine_memory_mb
from slamcmp.support.messages import LIMIT, describe, told
from slamcmp.support.progress import Watcher
from slamcmp.support.shared_arrays import SharedArrays
from slamcmp.types import Status

LOOK_EVERY_S = 0.1
LOOK_AHEAD = 64
"""Jobs among which one is looked for whose stream a worker has at hand."""
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
        *,
        alone: bool = False,
    ) -> None:
        self._stop, self._alone = stop, alone
        self._folder, self._workers, self._watcher = folder, workers, watcher
        self._stream_time_limit_s = experiment.stream_time_limit_s
        self._one_stream = len({trial.stream.key for trial in plan.trials}) == 1
        self._several_trials = len(plan.trials) > 1
        share = machine_memory_mb() * MEMORY_SHARE / workers.slots
        self._memory_limit_mb = experiment.memory_limit_mb or share
        self.stream_faults: dict[str, Fault] = {}
        self.lost: dict[str, Fault] = {}
        """Runs that have to be done again, by key."""
        self.fatal: SlamcmpError | None = None
        self.done = 0
        self.again = 0
        """Runs that had a result, of another stream than there is now."""
        self._standing = plan.standing
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
            self._remember_stream(load_truth(truth_path(folder, key)), key)
        self._packing = Packing(folder, plan.runs.values())
        self.pending = {*plan.runs, *plan.streams}
        """Keys of what is not done."""

    def run_all(self) -> None:
        """Start and finish jobs until none is left, an error concerns them all, or ``stop`` is set.

        Raises:
            StorageError: a worker could not write its result.
        """
        try:
            self._run_all()
        except ExecutorLostError as error:
            self.fatal = error

    def _run_all(self) -> None:
        running = 0
        while ((self._ready and self.fatal is None) or running) and not self._stop.is_set():
            while self._ready and running < self._workers.slots and self.fatal is None:
                running += self._start(self._next())
            for ended in self._workers.wait(LOOK_EVERY_S):
                running -= 1
                # A worker that Ctrl-C hit while it was starting has not failed.
                if not (ended.fault and self._stop.is_set()):
                    self._finish(ended)
            self._watcher.advanced(self._workers.frames_done())
            self._require_samples()
        # What came to its end while the signal came is done.
        for ended in self._workers.wait(0.0) if self._stop.is_set() else ():
            if not ended.fault:
                self._finish(ended)

    def _next(self) -> StreamJob | RunJob:
        """The next job: a run whose stream a worker without a job has at hand, or else another stream.

        What waits for a stream that a busy worker has is left to that one, until nothing else is to be done.
        """
        at_hand = self._workers.at_hand()
        ahead = list(islice(self._ready, LOOK_AHEAD if at_hand else 0))
        chosen = next((index for index, job in enumerate(ahead) if job.stream_key in at_hand), None)
        if chosen is None:
            chosen = next((index for index, job in enumerate(ahead) if isinstance(job, StreamJob)), 0)
        job = self._ready[chosen]
        del self._ready[chosen]
        return job

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
        swept = [point_name(trial.swept)] if trial.swept else []
        seed = [] if trial.seed is None else [trial.recording or f"seed {trial.seed}"]
        return f" ({', '.join([*swept, *seed])})"

    def _start(self, job: StreamJob | RunJob) -> bool:
        """Begin a job; False where it cannot be."""
        if isinstance(job, StreamJob):
            task, frames = self._stream_task(job), 0
        elif job.stream_key in self._frames:
            task, frames = self._run_task(job), self._frames[job.stream_key][1]
        else:
            self._lose(job.key, "missing", "what was known about its stream is gone")
            return False
        try:
            remove(task.result)
        except OSError as error:
            raise storage_error(task.result, error) from error
        try:
            self._workers.start(task)
        except (OSError, EOFError) as error:
            self.fatal = SlamcmpError(
                f"no worker process can be started ({describe(error)}); what finished is kept: run the same "
                "command again"
            )
            return False
        self._watcher.started(task.key, self._names[task.key], frames)
        return True

    def _stream_task(self, job: StreamJob) -> Task:
        plugins = (job.source.plugin(), job.front_end.plugin())
        return Task(
            "stream",
            job.key,
            self._folder,
            tuple((each.spec, each.arguments()) for each in (job.source, job.front_end)),
            job.seed,
            time_limit_s=self._stream_time_limit_s,
            code=job.code,
            data=job.data,
            watched=any("user_file" in plugin.traits for plugin in plugins),
            declared=tuple(map(_says_what_it_reads, plugins)),
            shares_process=all(map(is_own, plugins)),
        )

    def _run_task(self, job: RunJob) -> Task:
        plugin = job.back_end.plugin()
        return Task(
            "run",
            job.key,
            self._folder,
            ((job.back_end.spec, dict(job.back_end.parameters)),),
            job.seed,
            label=job.back_end.label,
            stream_key=job.stream_key,
            digest=self._frames[job.stream_key][0],
            time_limit_s=job.time_limit_s,
            memory_limit_mb=self._memory_limit_mb,
            record=job.record,
            own_gate=job.back_end.own_gate,
            code=job.code,
            data=job.data,
            watched="user_file" in plugin.traits,
            declared=(_says_what_it_reads(plugin),),
            alone=self._alone,
            shares_process=is_own(plugin) and not self._alone,
        )

    def _finish(self, ended: Ended) -> None:
        task = ended.task
        try:
            if ended.storage_failed:
                raise self._storage_failure(task)
            if task.kind == "stream":
                outcome = self._finish_stream(ended)
            elif ended.fault and ended.status == "missing":
                self._lose(task.key, "missing", self._why_missing(ended))
                outcome = "missing"
            else:
                outcome = self._finish_run(ended)
        finally:
            if ended.shared is not None:
                ended.shared.close()
        self.done += 1
        self._watcher.ended(task.key, outcome, ended.frames_done)
        if task.kind == "run":
            self._packing.run_done(task)

    def _finish_run(self, ended: Ended) -> str:
        task = ended.task
        try:
            if ended.fault:
                self._store_failure(ended)
            elif ended.note:
                _add_note(task, ended.note)
        except SlamcmpError:
            raise
        except Exception as error:
            # One run whose remains cannot be stored must not end those of all others.
            self._lose(
                task.key, "crashed", told(f"{ended.fault}; what it left cannot be kept: {describe(error)}")
            )
            return "crashed"
        self.pending.discard(task.key)
        stored = load_run(task.result)
        return "missing" if stored is None else stored.run.status

    def _lose(self, key: str, status: Status, message: str) -> None:
        """A run that has no result, and is done again by the same command."""
        self.lost[key] = Fault(status, message)
        self.pending.discard(key)

    def _why_missing(self, ended: Ended) -> str:
        if not ended.outdated:
            self._drop_damaged(stream_path(self._folder, ended.task.digest))
            done, frames = ended.frames_done, self._frames[ended.task.stream_key][1]
            return told(f"after {done} of {frames} frames: {ended.fault}{self._last_words(ended.task)}")
        return why_outdated(ended.task)

    def _drop_damaged(self, file: Path) -> None:
        """Have a stream made again that cannot be read; only this process writes to packs."""
        try:
            load_stream(file)
        except SlamcmpError:
            with contextlib.suppress(SlamcmpError, OSError):
                remove(file)

    def _finish_stream(self, ended: Ended) -> str:
        key = ended.task.key
        self.pending.discard(key)
        waiting = self._waiting.pop(key, [])
        known = None if ended.fault else load_truth(ended.task.result)
        if known is not None and known.error is None:
            self._remember_stream(known, key)
            self._packing.stream_done(key, known.digest)
            waiting = [*waiting, *self._of_another_stream(key, known)]
            # Before further streams: so few streams wait unread, and results appear early.
            self._ready.extendleft(reversed(waiting))
            return "ok"
        kind, message = known.error if known is not None and known.error is not None else ("", ended.fault)
        with contextlib.suppress(OSError):
            remove(ended.task.result)
        status: Status = ended.status if ended.fault and ended.status in OUTSIDE else "crashed"
        if not ended.fault and known is None:
            status, message = "missing", "its file is gone or cannot be read"
        elif ended.outdated:
            message = why_outdated(ended.task)
        self.stream_faults[key] = Fault(status, told(f"no stream: {message}"))
        self.pending -= {job.key for job in waiting}
        self.done += len(waiting)
        error_class = _error_class(kind)
        # A file that is not there is missing for every trial, and the fault of an only stream is all there is
        # to say. Settings that one grid point makes impossible cost that point only.
        if error_class is not None and (self._one_stream or issubclass(error_class, MissingDataError)):
            self.fatal = error_class(message)
        return message

    def _of_another_stream(self, key: str, known: StoredTruth) -> list[RunJob]:
        """The runs whose result, which is removed, is not of the stream and truth that were made just now."""
        jobs = []
        expected = known.digest, truth_digest(known.truth)
        for job in self._standing.get(key, []):
            path = run_path(self._folder, job.key)
            stored = load_run(path)
            if stored is None or (stored.run.digest, stored.scored_against) != expected:
                remove(path)
                jobs.append(job)
        self.again += len(jobs)
        self.pending |= {job.key for job in jobs}
        return jobs

    def _remember_stream(self, known: StoredTruth | None, key: str) -> None:
        if known is not None:
            self._frames[key] = known.digest, known.frames

    def _storage_failure(self, task: Task) -> StorageError:
        words = _log_text(task)
        return StorageError(
            words
            or f"cannot write {task.result}: is the disk full? What finished before is kept: "
            "make room and run the same command again"
        )

    def _store_failure(self, ended: Ended) -> None:
        """Put a row with all finished frames where a worker left none."""
        task = ended.task
        digest, frames = self._frames[task.stream_key]
        message = f"after {ended.frames_done} of {frames} frames: {ended.fault}{self._last_words(task)}"
        shared = SharedArrays() if ended.shared is None else ended.shared
        run = recovered(
            shared,
            ended.frames_done,
            label=task.label,
            parameters=task.plugins[0][1],
            digest=digest,
            seed=task.seed,
            frames=frames,
            status=ended.status,
            message=told(message),
            space_dim=self._space_dim(task),
        )
        known = load_truth(truth_path(self._folder, task.stream_key))
        stored = scored(run, None if known is None else known.truth)
        save_run(replace(stored, completion=ended.frames_done / frames), task.result)

    def _space_dim(self, task: Task) -> int:
        try:
            with np.load(io.BytesIO(content(stream_path(self._folder, task.digest)))) as file:
                return int(file["prior_T"].shape[0]) - 1
        except (OSError, ValueError, KeyError):
            # Gone meanwhile: nothing in an empty trajectory depends on it.
            return 2

    def _last_words(self, task: Task) -> str:
        with contextlib.suppress(OSError):
            if task.log.stat().st_size:
                return f"; its output is in {task.log}"
        return ""


def _says_what_it_reads(plugin: Plugin) -> bool:
    return "user_file" not in plugin.traits or "files" in plugin.traits


def _log_text(task: Task) -> str:
    try:
        return told(task.log.read_bytes()[-LIMIT:].decode(errors="replace").strip())
    except OSError:
        return ""


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
