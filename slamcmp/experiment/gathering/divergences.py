"""Posteriors that a trial's runs kept, compared with those of its batch solution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from slamcmp.experiment.job.task import posteriors_path
from slamcmp.experiment.planning.trials import RunJob, Trial
from slamcmp.metrics.information import KL, last_kl, median_kl
from slamcmp.results.runs.posteriors import kl_series, load_posteriors
from slamcmp.results.runs.run_file import StoredRun


class Divergences:
    """Compares the posteriors that a trial's runs kept with those of its batch solution."""

    def __init__(self, trial: Trial, folder: Path) -> None:
        self._folder = folder
        named = {job.record.divergence_from for job in trial.runs if job.record is not None}
        self._reference = [
            posterior
            for job in trial.runs
            if job.back_end.label in named
            for posterior in load_posteriors(posteriors_path(folder, job.key))
        ]

    def added(self, job: RunJob, stored: StoredRun) -> StoredRun:
        """The run with its divergence as a series and as scores."""
        if not self._reference:
            return stored
        own = load_posteriors(posteriors_path(self._folder, job.key))
        run = stored.run
        series = kl_series(own, self._reference, run.online.t.size)
        run = replace(run, diagnostics={**run.diagnostics, KL: series})
        return replace(
            stored, run=run, scores={**stored.scores, KL: last_kl(run), f"{KL}_median": median_kl(run)}
        )
