"""What an experiment would do: its trials, and which jobs have no result yet."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from slamcmp.experiment.config.experiment import Experiment
from slamcmp.experiment.job.task import run_path, stream_path, truth_path
from slamcmp.experiment.trials import RunJob, StreamJob, Trial, make_trials
from slamcmp.results.run_file import load_truth, run_status


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
