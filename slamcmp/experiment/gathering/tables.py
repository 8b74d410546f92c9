"""Finished runs gathered into the three tables."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from slamcmp.errors import NoSampleError, SlamcmpError
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.gathering.inspection import FINDINGS, Inspector
from slamcmp.experiment.gathering.own_names import own_names, with_own_names
from slamcmp.experiment.job.fault import Fault
from slamcmp.experiment.job.task import posteriors_path, run_path, stream_path, truth_path
from slamcmp.experiment.planning.samples import Samples
from slamcmp.experiment.planning.trials import RunJob, Trial
from slamcmp.metrics import frame_table, landmark_table, metric_columns, reference_truth, score_run
from slamcmp.metrics.association import association_counts, association_scores
from slamcmp.metrics.information import KL, last_kl, median_kl
from slamcmp.results.runs.of_runs import COST_COLUMNS, outcome
from slamcmp.results.runs.posteriors import kl_series, load_posteriors
from slamcmp.results.runs.run_file import StoredRun, StoredTruth, load_run, load_truth, relabelled
from slamcmp.support.messages import describe, told
from slamcmp.support.opened_files import UNKNOWN, changed
from slamcmp.types import GroundTruth

KEYS = ("trial", "label", "back_end", "seed", "digest", "own_gate")
UNREADABLE = Fault(
    "missing", "the file of its result is gone or cannot be read; the same command runs it again"
)


class Tables(NamedTuple):
    """All that was found, and what a reader of it must know."""

    trials: pd.DataFrame
    frames: pd.DataFrame
    landmarks: pd.DataFrame
    warnings: tuple[str, ...] = ()
    fault: SlamcmpError | None = None
    """Why rows are marked that have a result all the same."""


def gather(
    trials: Sequence[Trial],
    folder: Path,
    reference: str | None,
    stream_faults: Mapping[str, Fault],
    lost: Mapping[str, Fault] | None = None,
    pending: Collection[str] = (),
) -> Tables:
    """The trials, frames and landmarks of every run that lies in the folder.

    Args:
        trials: of the experiment.
        folder: with its results.
        reference: label of the back end whose final solution plays truth where there is none.
        stream_faults: by stream key, why a stream could not be made: its runs become failed rows.
        lost: by run key, why there is no result.
        pending: keys of the jobs that were not come to; only these have no row.

    What must not stand side by side (runs of one trial on different streams, one stream as two samples) is
    marked in its rows: nothing that was computed is lost over it.
    """
    gathering = _Gathering(trials, folder, reference, stream_faults, lost or {}, pending)
    for trial in trials:
        gathering.add(trial)
    rows = gathering.rows
    warnings = list(gathering.warnings)
    tables: list[pd.DataFrame] = []
    for name, found in (("frames", gathering.frames), ("landmarks", gathering.landmarks)):
        try:
            tables.append(_joined(found, trials))
        except MemoryError:
            found.clear()
            tables.append(_joined([], trials))
            warnings.append(f"there is not enough memory for the table of {name}: it is empty")
    of_trials = _typed(pd.DataFrame(rows, columns=_columns(trials, rows)))
    return Tables(of_trials, tables[0], tables[1], tuple(warnings), gathering.fault)


class _Gathering:
    """The rows so far."""

    def __init__(
        self,
        trials: Sequence[Trial],
        folder: Path,
        reference: str | None,
        stream_faults: Mapping[str, Fault],
        lost: Mapping[str, Fault],
        pending: Collection[str],
    ) -> None:
        self._folder, self._reference = folder, reference
        self._stream_faults, self._lost, self._pending = stream_faults, lost, pending
        self._kinds = _kinds(trials)
        self._samples = Samples()
        self.rows: list[dict[str, Any]] = []
        self.frames: list[pd.DataFrame] = []
        self.landmarks: list[pd.DataFrame] = []
        self.warnings: dict[str, None] = {}
        self.fault: SlamcmpError | None = None

    def add(self, trial: Trial) -> None:
        """The rows of one trial: one a run, but for those that were not come to."""
        fault = self._stream_faults.get(trial.stream.key)
        if fault is not None:
            for job in trial.runs:
                self._add_fault(trial, job, fault)
            return
        known, found = self._read(trial)
        if known is not None:
            self._mark_other_streams(trial, known, found)
            self._mark_no_sample(trial, known, found)
        runs = [run for run in found.values() if isinstance(run, StoredRun)]
        truth, name, inspector = None, "none", None
        if known is not None:
            truth, name = trial_truth(known, runs, self._reference)
            borrowed = truth is not None and known.truth is None
            file = stream_path(self._folder, known.digest)
            inspector = Inspector(file, truth, borrowed, known.own_ids)
        digest = "" if known is None else known.digest
        # In the order of the file, whatever became of each.
        for job in trial.runs:
            run = found.get(job.key)
            if isinstance(run, StoredRun) and known is not None and inspector is not None:
                unseen = run.inputs.get(UNKNOWN)
                if unseen:
                    self.warnings[
                        f"{job.back_end.label} is run anew each time, for it uses {unseen}, which may read "
                        "files that nobody sees; name them with @back_ends.register(..., files=...) and its "
                        "results are kept"
                    ] = None
                try:
                    self._add_run(trial, job, run, known, truth, name, inspector)
                except Exception as error:
                    self._add_fault(trial, job, _not_gathered(error), digest)
            elif isinstance(run, Fault):
                self._add_fault(trial, job, run, digest)

    def _mark_other_streams(
        self, trial: Trial, known: StoredTruth, found: dict[str, StoredRun | Fault]
    ) -> None:
        other = [
            (key, run.run.digest)
            for key, run in found.items()
            if isinstance(run, StoredRun) and run.run.digest != known.digest
        ]
        if not other:
            return
        digests = ", ".join(sorted({known.digest[:12], *(digest[:12] for _, digest in other)}))
        self.fault = self.fault or SlamcmpError(
            f"trial {trial.number}: its back ends ran on different streams ({digests}), so their results "
            "cannot be compared; the source or the front end does not repeat itself: delete the results "
            "folder and make them depend on nothing but the seed; until then these rows are marked as missing"
        )
        for key, digest in other:
            found[key] = Fault("missing", f"it ran on another stream ({digest[:12]}) than its trial's")

    def _mark_no_sample(self, trial: Trial, known: StoredTruth, found: dict[str, StoredRun | Fault]) -> None:
        if not known.digest:
            return
        try:
            self._samples.add(trial, known.digest)
        except NoSampleError as error:
            self.fault = self.fault or error
            marked = Fault("missing", f"no sample of its own: {error.reason}")
            found.update(dict.fromkeys((job.key for job in trial.runs), marked))

    def _read(self, trial: Trial) -> tuple[StoredTruth | None, dict[str, StoredRun | Fault]]:
        """What is known about a trial, and each run that was come to, or why it cannot be read."""
        found: dict[str, StoredRun | Fault] = {}
        known: StoredTruth | None = None
        fault = Fault("missing", "what is known about its stream is gone or cannot be read")
        try:
            known = load_truth(truth_path(self._folder, trial.stream.key))
            divergences = _Divergences(trial, self._folder)
        except MemoryError as error:
            known, fault = None, _not_gathered(error)
        for job in trial.runs:
            if job.key in self._pending:
                # An older result, or one that was written while the run was interrupted.
                kept = None if known is None else load_run(run_path(self._folder, job.key))
                if known is None or kept is None or kept.run.digest != known.digest:
                    continue
            if job.key in self._lost:
                found[job.key] = self._lost[job.key]
            elif known is None:
                found[job.key] = fault
            else:
                try:
                    found[job.key] = self._read_run(job, known, divergences)
                except MemoryError as error:
                    found[job.key] = _not_gathered(error)
        return known, found

    def _read_run(self, job: RunJob, known: StoredTruth, divergences: _Divergences) -> StoredRun | Fault:
        run = load_run(run_path(self._folder, job.key))
        if run is None:
            return UNREADABLE
        other = changed({**known.inputs, **run.inputs})
        if other:
            return _reads_something_else(other)
        message = with_own_names(run.run.message, known.own_ids)
        run = replace(run, run=replace(run.run, message=message))
        return divergences.added(job, relabelled(run, job.back_end.label))

    def _add_run(
        self,
        trial: Trial,
        job: RunJob,
        run: StoredRun,
        known: StoredTruth,
        truth: GroundTruth | None,
        reference: str,
        inspector: Inspector,
    ) -> None:
        borrowed = truth is not None and known.truth is None
        keys = _keys(trial, job.back_end, run.run.digest, self._kinds)
        scores = score_run(run.run, truth, reference=True) if borrowed else run.scores
        recorded = {} if job.record is None else {"record": job.record.describe()}
        row = {
            **keys,
            **scores,
            **({} if known.association is None else association_scores(known.association)),
            **outcome(run.run, run.completion, reference),
            **inspector.findings(run.run),
            **recorded,
        }
        of_frames = frame_table(run.run, truth, reference=borrowed, taken=keys)
        if known.association is not None:
            for name, series in association_counts(known.association).items():
                of_frames[name] = series[: len(of_frames)]
        of_landmarks = landmark_table(run.run, truth, reference=borrowed)
        if known.own_ids is not None:
            of_landmarks["id"] = own_names(of_landmarks["id"].to_numpy(), known.own_ids)
        for table in (of_frames, of_landmarks):
            for position, (key, value) in enumerate(keys.items()):
                table.insert(position, key, value)
        self.rows.append(row)
        self.frames.append(of_frames)
        self.landmarks.append(of_landmarks)

    def _add_fault(self, trial: Trial, job: RunJob, fault: Fault, digest: str = "") -> None:
        row = _row_without_result(_keys(trial, job.back_end, digest, self._kinds), fault)
        recorded = {} if job.record is None else {"record": job.record.describe()}
        self.rows.append({**row, **recorded})


def _reads_something_else(paths: Sequence[str]) -> Fault:
    names = ", ".join(sorted({Path(path).name for path in paths}))
    return Fault("missing", told(f"what it read has changed since ({names}); the same command runs it again"))


def _not_gathered(error: Exception) -> Fault:
    if isinstance(error, MemoryError):
        return Fault("missing", "there is not enough memory to read its result; the result itself is kept")
    return Fault("missing", f"its result could not be put into the tables: {describe(error)}")


class _Divergences:
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


def trial_truth(
    known: StoredTruth, runs: Sequence[StoredRun], reference: str | None
) -> tuple[GroundTruth | None, str]:
    """What the runs of a trial are compared with, and its name in the tables."""
    if known.truth is not None:
        return known.truth, "truth"
    for stored in runs:
        run = stored.run
        if run.back_end == reference and run.status == "ok" and run.final is not None:
            return reference_truth(run), f"{reference} (final)"
    return None, "none"


def _keys(trial: Trial, choice: Component, digest: str, kinds: Mapping[str, str]) -> dict[str, Any]:
    return {
        "trial": trial.number,
        "label": choice.label,
        "back_end": choice.name,
        "seed": trial.seed,
        **({"recording": trial.recording} if trial.recording else {}),
        "digest": digest,
        # Where there is a number, the run used its own choice of that stream's observations.
        "own_gate": math.nan if choice.own_gate is None else choice.own_gate,
        **{path: _cell(value, kinds[path]) for path, value in trial.swept.items()},
    }


def _row_without_result(keys: Mapping[str, Any], fault: Fault) -> dict[str, Any]:
    return {
        **keys,
        "status": fault.status,
        "message": fault.message,
        "completion": 0.0,
        "frames": 0,
        "reference": "none",
        **dict.fromkeys(COST_COLUMNS, math.nan),
        **FINDINGS,
    }


def _columns(trials: Sequence[Trial], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    swept = list(trials[0].swept) if trials else []
    outcome = ["status", "message", "completion", "frames", "reference", *COST_COLUMNS]
    columns = [*KEYS, *swept, *outcome, *FINDINGS, *metric_columns()]
    return list(dict.fromkeys([*columns, *(name for row in rows for name in row)]))


def _joined(tables: Sequence[pd.DataFrame], trials: Sequence[Trial]) -> pd.DataFrame:
    filled = [table for table in tables if len(table)]
    if not filled:
        swept = list(trials[0].swept) if trials else []
        return tables[0].iloc[:0] if tables else pd.DataFrame(columns=[*KEYS, *swept])
    return _typed(pd.concat(filled, ignore_index=True))


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    # Names of landmarks may take all 64 bits; a float would round them.
    whole = {"trial": "int64", "seed": "Int64", "departure_landmark": "Int64"}
    return table.astype({name: kind for name, kind in whole.items() if name in table})


def _kinds(trials: Sequence[Trial]) -> dict[str, str]:
    """What each swept path's column holds: ``bool``, ``number``, or ``text`` where kinds are mixed."""
    found: dict[str, set[str]] = {}
    for trial in trials:
        for path, value in trial.swept.items():
            known = found.setdefault(path, set())
            if isinstance(value, bool):
                known.add("bool")
            elif isinstance(value, int | float):
                known.add("number")
            elif value is not None:
                known.add("text")
    return {path: next(iter(known)) if len(known) == 1 else "text" for path, known in found.items()}


def _cell(value: Any, kind: str) -> Any:
    """A swept value as a column of that kind can hold it; null is a missing one."""
    if value is None:
        return math.nan if kind == "number" else None
    return json.dumps(value) if kind == "text" and not isinstance(value, str) else value
