"""What an experiment would do: its trials, and which jobs have no result yet."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.job.fault import OUTSIDE
from slamcmp.experiment.job.task import run_path, stream_path, truth_path
from slamcmp.experiment.planning.settled import settled_keys
from slamcmp.experiment.planning.trials import RunJob, StreamJob, Trial, make_trials
from slamcmp.results.runs.gathered import GatheredParts
from slamcmp.results.runs.run_file import load_run, load_truth
from slamcmp.support.files.packed_files import names_in
from slamcmp.support.provenance.opened_files import unchanged


@dataclass
class Plan:
    """What an experiment would do: its trials, and which jobs have no result yet."""

    trials: list[Trial]
    streams: dict[str, StreamJob] = field(default_factory=dict)
    """To be made, by key."""
    runs: dict[str, RunJob] = field(default_factory=dict)
    """To be run, by key."""
    standing: dict[str, list[RunJob]] = field(default_factory=dict)
    """Runs whose results stand if their stream, by its key, comes out as it was."""
    reused: int = 0
    """Runs whose results are there."""


def plan_experiment(
    experiment: Experiment,
    folder: Path,
    *,
    rerun_failed: bool = False,
    tried: Collection[str] = (),
    trials: list[Trial] | None = None,
) -> Plan:
    """Find out what is left to do, without doing it; the jobs whose keys are in ``tried`` are settled.

    ``trials`` are the experiment's, where they are known already.
    """
    plan = Plan(make_trials(experiment) if trials is None else trials)
    seen: set[str] = set(tried)
    streams_there, runs_there = names_in(folder / "streams"), names_in(folder / "runs")
    parts = GatheredParts(folder)
    key_of = settled_keys(plan.trials, experiment.reference) if parts.trials else None
    for trial in plan.trials:
        if trial.stream.key in seen:
            continue
        settled = None if key_of is None else parts.find(key_of(trial))
        if settled is not None and (settled.is_ok or not rerun_failed):
            new = {job.key for job in trial.runs} - seen
            seen |= new
            plan.reused += len(new)
            continue
        try:
            path = truth_path(folder, trial.stream.key)
            known = load_truth(path) if path.name in streams_there else None
        except MemoryError:
            # Its worker, or its rows, will say so.
            known = None
        gone = known is None or known.error is not None or not unchanged(known.inputs)
        waiting = False
        for job in trial.runs:
            if job.key in seen:
                waiting = waiting or job.key in plan.runs
                continue
            seen.add(job.key)
            path = run_path(folder, job.key)
            if path.name in runs_there and _has_result(path, rerun_failed):
                plan.reused += 1
                if gone:
                    plan.standing.setdefault(trial.stream.key, []).append(job)
            else:
                plan.runs[job.key] = job
                waiting = True
        lacks_stream = known is not None and stream_path(folder, known.digest).name not in streams_there
        if gone or (waiting and lacks_stream):
            plan.streams[trial.stream.key] = trial.stream
    return plan


def _has_result(path: Path, rerun_failed: bool) -> bool:
    """Whether a run's result can be used: it is there, and what it read besides is what it was."""
    try:
        stored = load_run(path)
    except MemoryError:
        # It will be a row that says so.
        return True
    if stored is None or stored.run.status in OUTSIDE or (rerun_failed and stored.run.status != "ok"):
        return False
    return unchanged(stored.inputs)
