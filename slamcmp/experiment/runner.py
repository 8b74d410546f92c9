"""Run an experiment: every trial's stream, every back end on it, then the tables."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slamcmp.backends.filters.loops import prepare
from slamcmp.errors import SlamcmpError, UsageError
from slamcmp.experiment.config.experiment import Experiment, load_experiment
from slamcmp.experiment.executors.processes import Executor, Processes
from slamcmp.experiment.gathering.manifest import describe_origin, now, require_same_experiment
from slamcmp.experiment.gathering.tables import gather
from slamcmp.experiment.job.fault import OUTSIDE, Fault
from slamcmp.experiment.job.task import run_path
from slamcmp.experiment.planning.plan import Plan, plan_experiment
from slamcmp.experiment.planning.samples import names_of
from slamcmp.experiment.planning.trials import RunJob, Trial, make_trials
from slamcmp.experiment.schedule import Schedule
from slamcmp.experiment.shared_cache import SharedCache, shared_cache
from slamcmp.experiment.stop_search import MetricValues, describe_stop, precisions
from slamcmp.registry import executors
from slamcmp.results.runs.gathered import AboutStream
from slamcmp.results.runs.run_file import load_run
from slamcmp.results.store import Results, save_results
from slamcmp.support.cores import available_cores
from slamcmp.support.files.atomic import remove_left_behind, write_atomically
from slamcmp.support.files.lock import locked
from slamcmp.support.files.packed_files import is_there
from slamcmp.support.interruption import interruptions
from slamcmp.support.progress import unbreakable, watching

PLANNED = ".progress.json"
"""What a run is about to do, in its results folder."""


class Interrupted(SlamcmpError):
    """Ctrl-C, or a signal to end: what was done is in the tables, the rest runs when started again."""

    exit_code = 130

    def __init__(self, results: Results) -> None:
        missing = results.manifest["jobs_missing"]
        left = f"{missing} jobs are left" if missing else "seeds were still to be added"
        super().__init__(
            f"interrupted: {left}; what finished is in {results.folder}; the same command goes on from there"
        )
        self.results = results


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
    cache: bool = True,
    scheduler: str | None = None,
    times: bool = False,
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
        scheduler: address of the Dask scheduler whose workers run the jobs, for the executor ``dask``; None:
            a cluster of this machine's own.
        times: when all else is done, run every back end once more, one job at a time and each in a process
            of its own: its times are then its own.
        cache: take results of equal key from the shared cache (shared_cache.py), and keep new ones there.

    Returns:
        The tables and the manifest, as they were saved.

    Raises:
        UsageError: the configuration cannot be used, or another run writes to the same folder.
        MissingDataError: a file the experiment needs is not there.
        NoSampleError: two seeds or recordings are one and the same stream; what ran is in the tables, and
            rows of the second are marked.
        StorageError: a result cannot be written.
        Interrupted: Ctrl-C, SIGTERM or SIGHUP; what was done is saved.
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
    if scheduler is not None and not place.traits.get("scheduler"):
        raise UsageError(f"executor {executor!r} knows no scheduler: take executor 'dask' or leave it out")
    workers: Executor = place.target(slots=slots, **({} if scheduler is None else {"scheduler": scheduler}))
    prepare(back_end.plugin().target for back_end in experiment.back_ends)
    side_by_side = workers.slots
    rounds = _Rounds(shared_cache() if cache else None)
    with locked(folder), interruptions(raising=bool(place.traits.get("in_process", False))) as stop:
        require_same_experiment(experiment, folder)
        remove_left_behind(folder, folder / "runs", folder / "streams")
        try:
            rounds.run_all(experiment, folder, workers, stop, rerun_failed=rerun_failed, progress=progress)
            if times and rounds.fatal is None and not stop.is_set():
                workers.close()
                in_process = bool(place.traits.get("in_process", False))
                workers = place.target(slots=1) if in_process else Processes(slots=1)
                rounds.time_all(experiment, folder, workers, stop, progress=progress)
        except KeyboardInterrupt:
            stop.set()
        # After a StorageError no tables: they would meet the same full disk; finished runs are kept.
        finally:
            workers.close()
        tables = gather(
            rounds.plan.trials,
            folder,
            experiment.reference,
            rounds.stream_faults,
            rounds.lost,
            rounds.pending,
        )
        again = int(tables.trials["status"].isin(OUTSIDE).sum())
        about_streams = _about_streams(tables.streams, experiment.reference)
        manifest |= {
            "finished": now(),
            "wall_s": time.monotonic() - begin,
            "jobs": side_by_side,
            "jobs_run": rounds.done,
            "jobs_reused": rounds.plan.reused - rounds.again,
            "jobs_from_cache": rounds.from_cache,
            **({"jobs_timed": rounds.timed} if times else {}),
            "jobs_missing": len(rounds.pending) + again,
            **names_of(rounds.plan.trials),
            **about_streams,
            "warnings": [*about_streams["warnings"], *tables.warnings],
            **({} if rounds.search is None else {"until": rounds.search}),
        }
        results = Results(folder, manifest, tables.trials, tables.frames, tables.landmarks)
        save_results(results)
    if rounds.fatal is not None:
        raise rounds.fatal
    if tables.fault is not None:
        raise tables.fault
    if stop.is_set() and (rounds.pending or rounds.unfinished):
        raise Interrupted(results)
    return results


def _untimed(trials: Sequence[Trial], folder: Path) -> dict[str, RunJob]:
    """The jobs, by key, that ended well and have no times of their own yet."""
    found: dict[str, RunJob] = {}
    for trial in trials:
        for job in trial.runs:
            stored = load_run(run_path(folder, job.key)) if job.record is None else None
            if stored is not None and stored.run.status == "ok" and not stored.timed_alone:
                found[job.key] = job
    return found


class _Rounds:
    """One round of jobs; with ``until``, more rounds of more seeds until the answer is precise enough."""

    def __init__(self, cache: SharedCache | None) -> None:
        self._cache = cache
        self.from_cache = 0
        self.timed = 0
        """Runs that were done once more for their times."""
        """Runs whose results another folder's experiment had computed."""
        self.plan = Plan([])
        """Of the last round; its trials are those of all rounds."""
        self.stream_faults: dict[str, Fault] = {}
        self.lost: dict[str, Fault] = {}
        """Runs that have to be done again, by key."""
        self.pending: set[str] = set()
        """Keys of the jobs that were not come to."""
        self.fatal: SlamcmpError | None = None
        self.search: dict[str, Any] | None = None
        """How the search for enough seeds ended, for the manifest."""
        self.done = 0
        self.again = 0
        """Runs that had a result, of another stream than there is now."""
        self.unfinished = False
        """Ctrl-C came before the search was over."""
        self._tried: set[str] = set()

    def time_all(
        self,
        experiment: Experiment,
        folder: Path,
        workers: Executor,
        stop: threading.Event,
        *,
        progress: bool,
    ) -> None:
        """Run what ended well once more, one job at a time; results stay the same but for their times."""
        again = Plan(self.plan.trials, runs=_untimed(self.plan.trials, folder))
        with watching(len(again.runs), show=progress) as watcher:
            schedule = Schedule(again, folder, workers, unbreakable(watcher), experiment, stop, alone=True)
            try:
                schedule.run_all()
            except KeyboardInterrupt:
                stop.set()
        self.lost |= schedule.lost
        # A job that was begun and not ended has no result; those that were not begun keep theirs.
        self.pending |= {key for key in schedule.pending if not is_there(run_path(folder, key))}
        self.fatal = schedule.fatal
        self.timed = schedule.done

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
            trials = make_trials(experiment)
            brought: set[str] = set()
            if self._cache is not None:
                brought = self._cache.bring(trials, folder)
            plan = plan_experiment(
                experiment, folder, rerun_failed=rerun_failed, tried=self._tried, trials=trials
            )
            self.plan = plan
            # Not those that read what has changed meanwhile.
            self.from_cache += len(brought - plan.runs.keys())
            todo = len(plan.runs) + len(plan.streams)
            self._tried |= {*plan.runs, *plan.streams}
            _tell_plan(experiment, plan, folder)
            with watching(todo, show=progress) as watcher:
                schedule = Schedule(plan, folder, workers, unbreakable(watcher), experiment, stop)
                try:
                    schedule.run_all()
                except KeyboardInterrupt:
                    stop.set()
            self.stream_faults |= schedule.stream_faults
            self.lost |= schedule.lost
            self.pending = schedule.pending
            if self._cache is not None:
                undone = schedule.pending | schedule.lost.keys()
                self._cache.keep(plan.streams.keys() - undone, plan.runs.keys() - undone, folder)
            self.fatal = schedule.fatal
            self.done += schedule.done
            self.again += schedule.again
            if rule is None or values is None:
                return
            found = precisions(rule, values.table(plan.trials), labels)
            seeds = len(experiment.seeds)
            over = not found or all(each.enough for each in found) or seeds >= rule.max_seeds
            self.unfinished = stop.is_set() and not (over and not self.pending)
            self.search = describe_stop(rule, found, seeds, interrupted=self.unfinished)
            if over or stop.is_set() or self.fatal is not None:
                return
            experiment = experiment.with_more_seeds()


def _tell_plan(experiment: Experiment, plan: Plan, folder: Path) -> None:
    """What will be done, for who looks at the folder meanwhile (report/watch.py)."""
    told = {
        "name": experiment.name,
        "question": experiment.question,
        "labels": [choice.label for choice in experiment.back_ends],
        "runs": {job.key: job.back_end.label for trial in plan.trials for job in trial.runs},
    }
    write_atomically(folder / PLANNED, lambda file: file.write(json.dumps(told).encode()))


def _about_streams(streams: Sequence[AboutStream], reference: str | None) -> dict[str, Any]:
    """What the front end let through, over all trials, and what a reader must know about the streams."""
    totals: dict[str, int] = {}
    warnings: dict[str, None] = {}
    for known in streams:
        warnings |= dict.fromkeys(known.warnings)
        for name, count in known.front_end.items():
            totals[name] = totals.get(name, 0) + count
    empty = sum(
        known.front_end.get("kept") == 0 and not known.front_end.get("loop closures") for known in streams
    )
    without_truth = sum(not known.failed and not known.has_truth for known in streams)
    if empty:
        warnings[
            f"the front end kept no detection in {empty} of {len(streams)} streams: there, every back end "
            "had nothing but odometry"
        ] = None
    if without_truth and reference is None:
        warnings[
            "no truth: set reference to the label of a smoother, whose final solution then takes its place "
            f"({without_truth} of {len(streams)} streams)"
        ] = None
    return {"front_end_totals": totals, "warnings": list(warnings)}
