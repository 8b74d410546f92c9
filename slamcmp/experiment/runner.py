"""Run an experiment: every trial's stream, every back end on it, then the tables."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import slamcmp.errors
from slamcmp.atomic import storage_error
from slamcmp.errors import MissingDataError, SlamcmpError, StorageError
from slamcmp.experiment.config import Experiment, load_experiment
from slamcmp.experiment.content_key import versions
from slamcmp.experiment.executors import Ended, Executor
from slamcmp.experiment.interruption import interruptions
from slamcmp.experiment.manifest import describe_origin, now, require_same_experiment
from slamcmp.experiment.memory import machine_memory_mb
from slamcmp.experiment.progress import Watcher, watching
from slamcmp.experiment.run_file import StoredRun, load_run, load_truth, run_status, save_run
from slamcmp.experiment.stop_search import MetricValues, describe_stop, precisions
from slamcmp.experiment.store import Results, locked, save_results
from slamcmp.experiment.tables import gather
from slamcmp.experiment.trials import RunJob, StreamJob, Trial, make_trials
from slamcmp.experiment.worker import Task, run_path, scored, stream_path, truth_path
from slamcmp.metrics import score_run
from slamcmp.registry import executors
from slamcmp.types import Run, Status, Trajectory

LOOK_EVERY_S = 0.1
MEMORY_SHARE = 0.9
"""Of the machine's memory that all workers together may take, where the experiment sets no limit."""


class Interrupted(SlamcmpError):
    """Ctrl-C: what was done is in the tables, the rest runs when the experiment is started again."""

    exit_code = 130

    def __init__(self, results: Results) -> None:
        missing = results.manifest["jobs_missing"]
        left = f"{missing} jobs are left" if missing else "seeds were still to be added"
        super().__init__(
            f"interrupted: {left}; what finished is in {results.folder}; the same command goes on from there"
        )
        self.results = results


@dataclass
class Plan:
    """What an experiment would do: its trials, and which jobs have no result yet."""

    trials: list[Trial]
    streams: dict[str, StreamJob] = field(default_factory=dict)
    """To be made, by key."""
    runs: dict[str, RunJob] = field(default_factory=dict)
    """To be run, by key."""
    reused: int = 0
    """Runs whose results are there."""


def plan_experiment(
    experiment: Experiment,
    folder: Path,
    *,
    rerun_failed: bool = False,
    tried: Collection[str] = (),
) -> Plan:
    """Find out what is left to do, without doing it; the jobs whose keys are in ``tried`` are settled."""
    plan = Plan(make_trials(experiment))
    seen: set[str] = set(tried)
    for trial in plan.trials:
        if trial.stream.key in seen:
            continue
        waiting = False
        for job in trial.runs:
            if job.key in seen:
                waiting = waiting or job.key in plan.runs
                continue
            seen.add(job.key)
            status = run_status(run_path(folder, job.key))
            if status is None or (rerun_failed and status != "ok"):
                plan.runs[job.key] = job
                waiting = True
            else:
                plan.reused += 1
        known = load_truth(truth_path(folder, trial.stream.key))
        gone = known is None or known.error is not None
        if gone or (waiting and known is not None and not stream_path(folder, known.digest).is_file()):
            plan.streams[trial.stream.key] = trial.stream
    return plan


def run_experiment(
    experiment: Experiment | Path | str,
    *,
    folder: Path | str | None = None,
    jobs: int | None = None,
    rerun_failed: bool = False,
    seeds: Sequence[int] | None = None,
    executor: str = "processes",
    progress: bool = False,
    command: str = "",
) -> Results:
    """Run what has no result yet, and gather all results into tables in ``folder``.

    Args:
        experiment: a checked experiment, or the path of its YAML file.
        folder: where results go; default ``results/NAME``.
        jobs: how many jobs run at a time; default: one for each core.
        rerun_failed: also run again what did not end well.
        seeds: exactly these, in place of the experiment's own and of its ``until``.
        executor: registered name of where jobs run.
        progress: show progress on standard error.
        command: for the manifest.

    Returns:
        The tables and the manifest, as they were saved.

    Raises:
        UsageError: the configuration cannot be used, or another run writes to the same folder.
        MissingDataError: a file the experiment needs is not there.
        StorageError: a result cannot be written.
        Interrupted: Ctrl-C; what was done is saved.
    """
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    if seeds is not None:
        experiment = experiment.with_seeds(seeds)
    folder = Path("results") / experiment.name if folder is None else Path(folder)
    folder = folder.resolve()
    begin = time.monotonic()
    manifest = describe_origin(experiment, command)
    slots = jobs or available_cores()
    place = executors.get(executor)
    workers: Executor = place.target(slots=slots)
    rounds = _Rounds()
    with locked(folder), interruptions(catch=not place.traits.get("in_process", False)) as stop:
        require_same_experiment(experiment, folder)
        try:
            rounds.run_all(experiment, folder, workers, stop, rerun_failed=rerun_failed, progress=progress)
        except KeyboardInterrupt:
            stop.set()
        # After a StorageError no tables: they would meet the same full disk; finished runs are kept.
        finally:
            workers.close()
        tables = gather(rounds.plan.trials, folder, experiment.reference, rounds.stream_faults)
        manifest |= {
            "finished": now(),
            "wall_s": time.monotonic() - begin,
            "jobs": workers.slots,
            "jobs_run": rounds.done,
            "jobs_reused": rounds.plan.reused,
            "jobs_missing": rounds.missing,
            "seeds": rounds.seeds(),
            **_about_streams(rounds.plan.trials, folder),
            **({} if rounds.search is None else {"until": rounds.search}),
        }
        results = Results(folder, manifest, *tables)
        save_results(results)
    if rounds.fatal is not None:
        raise rounds.fatal
    if stop.is_set() and (rounds.missing or rounds.unfinished):
        raise Interrupted(results)
    return results


def available_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Rounds:
    """One round of jobs; with ``until``, more rounds of more seeds until the answer is precise enough."""

    def __init__(self) -> None:
        self.plan = Plan([])
        """Of the last round; its trials are those of all rounds."""
        self.stream_faults: dict[str, str] = {}
        self.fatal: SlamcmpError | None = None
        self.search: dict[str, Any] | None = None
        """How the search for enough seeds ended, for the manifest."""
        self.done = 0
        self.missing = 0
        self.unfinished = False
        """Ctrl-C came before the search was over."""
        self._tried: set[str] = set()

    def run_all(
        self,
        experiment: Experiment,
        folder: Path,
        workers: Executor,
        stop: threading.Event,
        *,
        rerun_failed: bool,
        progress: bool,
    ) -> None:
        rule = experiment.until
        values = None if rule is None else MetricValues(folder, rule.metric, experiment.reference)
        labels = [choice.label for choice in experiment.back_ends]
        while True:
            plan = plan_experiment(experiment, folder, rerun_failed=rerun_failed, tried=self._tried)
            self.plan = plan
            todo = len(plan.runs) + len(plan.streams)
            self._tried |= {*plan.runs, *plan.streams}
            with watching(todo, show=progress) as watcher:
                schedule = _Schedule(plan, folder, workers, watcher, experiment, stop)
                try:
                    schedule.run_all()
                except KeyboardInterrupt:
                    stop.set()
            self.stream_faults |= schedule.stream_faults
            self.fatal = schedule.fatal
            self.done += schedule.done
            self.missing = todo - schedule.done
            if rule is None or values is None:
                return
            found = precisions(rule, values.table(plan.trials), labels)
            seeds = len(experiment.seeds)
            over = not found or all(each.enough for each in found) or seeds >= rule.max_seeds
            self.unfinished = stop.is_set() and not (over and not self.missing)
            self.search = describe_stop(rule, found, seeds, interrupted=self.unfinished)
            if over or stop.is_set() or self.fatal is not None:
                return
            experiment = experiment.with_more_seeds()

    def seeds(self) -> list[int]:
        """Every seed that was used."""
        return list(dict.fromkeys(trial.seed for trial in self.plan.trials if trial.seed is not None))


class _Schedule:
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
        self._names: dict[str, str] = {}
        self._waiting: dict[str, list[RunJob]] = {}
        self._ready: deque[StreamJob | RunJob] = deque(plan.streams.values())
        for trial in plan.trials:
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

    def _suffix(self, trial: Trial) -> str:
        if not self._several_trials:
            return ""
        swept = [f"{path.rpartition('.')[2]}={value}" for path, value in trial.swept.items()]
        seed = [] if trial.seed is None else [f"seed {trial.seed}"]
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
                study=job.study,
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


def _about_streams(trials: Sequence[Trial], folder: Path) -> dict[str, Any]:
    """What the front end let through, over all trials, and what a reader must know about the streams."""
    totals: dict[str, int] = {}
    warnings: dict[str, None] = {}
    streams = empty = 0
    for key in dict.fromkeys(trial.stream.key for trial in trials):
        known = load_truth(truth_path(folder, key))
        if known is None:
            continue
        streams += 1
        warnings |= dict.fromkeys(known.warnings)
        empty += known.front_end.get("kept") == 0
        for name, count in known.front_end.items():
            totals[name] = totals.get(name, 0) + count
    if empty:
        warnings[
            f"the front end kept no detection in {empty} of {streams} streams: there, every back end had "
            "nothing but odometry"
        ] = None
    return {"front_end_totals": totals, "warnings": list(warnings)}
