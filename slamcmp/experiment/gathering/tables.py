"""Finished runs gathered into the three tables."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from slamcmp.errors import NoSampleError, SlamcmpError
from slamcmp.experiment.gathering.cells import (
    Keyed,
    joined,
    names_of_rows,
    row_without_result,
    run_keys,
    together,
    trial_columns,
    typed,
)
from slamcmp.experiment.gathering.cells import cell as _cell  # noqa: F401  As tests of tables know it.
from slamcmp.experiment.gathering.divergences import Divergences
from slamcmp.experiment.gathering.inspection import Inspector
from slamcmp.experiment.gathering.own_names import own_names, with_own_names
from slamcmp.experiment.job.fault import OUTSIDE, Fault
from slamcmp.experiment.job.task import run_path, stream_path, truth_path
from slamcmp.experiment.planning.samples import Samples
from slamcmp.experiment.planning.settled import kinds, settled_keys
from slamcmp.experiment.planning.settled import kinds as _kinds  # noqa: F401  As tests of tables know it.
from slamcmp.experiment.planning.trials import RunJob, Trial
from slamcmp.metrics import frame_table, landmark_table, reference_truth, score_run
from slamcmp.metrics.association import association_counts, association_scores
from slamcmp.results.runs.gathered import AboutStream, GatheredParts, Settled
from slamcmp.results.runs.of_runs import outcome
from slamcmp.results.runs.run_file import StoredRun, StoredTruth, load_run, load_truth, relabelled
from slamcmp.support.messages import describe, told
from slamcmp.support.provenance.opened_files import UNKNOWN, changed
from slamcmp.types import GroundTruth

UNREADABLE = Fault(
    "missing", "the file of its result is gone or cannot be read; the same command runs it again"
)


BLOCK_RUNS = 256
"""Rows of runs that are gathered before those of settled trials are put away."""
PARTS = 64
"""Of a large sweep, some: each is a few files."""


class Tables(NamedTuple):
    """All that was found, and what a reader of it must know."""

    trials: pd.DataFrame
    frames: pd.DataFrame
    landmarks: pd.DataFrame
    warnings: tuple[str, ...] = ()
    fault: SlamcmpError | None = None
    """Why rows are marked that have a result all the same."""
    streams: tuple[AboutStream, ...] = ()
    """What is known about each stream."""


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
    parts, key_of = GatheredParts(folder), settled_keys(trials, reference)
    block = max(BLOCK_RUNS, sum(len(trial.runs) for trial in trials) // PARTS)
    pieces: list[dict[str, pd.DataFrame]] = []
    settled: list[tuple[Trial, Settled]] = []
    for trial in trials:
        known = parts.find(key_of(trial)) if parts.trials else None
        if known is not None and gathering.takes(trial, known):
            settled.append((trial, known))
            continue
        gathering.add(trial)
        if len(gathering.rows) >= block:
            pieces.append(gathering.flushed(parts, key_of))
    if settled:
        rows, damaged = parts.rows([(trial.number, known) for trial, known in settled])
        pieces.append(rows)
        for trial in [trial for trial, _ in settled if trial.number in set(damaged)]:
            gathering.add(trial)
    pieces.append(gathering.flushed(None, key_of))
    warnings = list(gathering.warnings)
    of_trials = typed(together([each["trials"] for each in pieces if "trials" in each]))
    of_trials = of_trials[trial_columns(trials, list(of_trials.columns))]
    tables: list[pd.DataFrame] = []
    for name in ("frames", "landmarks"):
        try:
            tables.append(typed(together([each.pop(name) for each in pieces if name in each])))
        except MemoryError:
            tables.append(joined([], trials))
            warnings.append(f"there is not enough memory for the table of {name}: it is empty")
    return Tables(
        of_trials, tables[0], tables[1], tuple(warnings), gathering.fault, tuple(gathering.streams.values())
    )


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
        self._trials = trials
        self._kinds = kinds(trials)
        self._samples = Samples()
        self.rows: list[dict[str, Any]] = []
        self.frames: list[Keyed] = []
        self.landmarks: list[Keyed] = []
        self.warnings: dict[str, None] = {}
        self.fault: SlamcmpError | None = None
        self.streams: dict[str, AboutStream] = {}
        self._settled: list[tuple[Trial, str, bool]] = []
        """Since the last flush: trials whose rows stay as they are, digest, and whether all is well."""

    def takes(self, trial: Trial, known: Settled) -> bool:
        """Whether a trial's rows can be taken as they were gathered before."""
        keys = [job.key for job in trial.runs]
        if trial.stream.key in self._stream_faults or any(
            key in self._lost or key in self._pending for key in keys
        ):
            return False
        try:
            self._samples.add(trial, known.digest)
        except NoSampleError:
            return False
        self.streams[trial.stream.key] = known.stream
        return True

    def flushed(self, parts: GatheredParts | None, key_of: Callable[[Trial], str]) -> dict[str, pd.DataFrame]:
        """The tables of what was added since, which is forgotten; settled trials are kept in ``parts``."""
        tables = {
            "trials": typed(
                pd.DataFrame(self.rows, columns=trial_columns(self._trials, names_of_rows(self.rows)))
            )
        }
        for name, found in (("frames", self.frames), ("landmarks", self.landmarks)):
            # Where there is no memory for it, it is told at the end, and nothing is kept of this piece.
            with contextlib.suppress(MemoryError):
                tables[name] = joined(found, self._trials)
            found.clear()
        settled, self.rows, self._settled = self._settled, [], []
        if parts is not None and settled and len(tables) == 3:
            of_trials = [
                (key_of(trial), _files(trial), digest, is_ok, self.streams[trial.stream.key])
                for trial, digest, is_ok in settled
            ]
            numbers = [trial.number for trial, _, _ in settled]
            parts.add(of_trials, tables, numbers)
            parts.pack([f"streams/{digest}.npz" for _, digest, _ in settled])
        return tables

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
        if known is not None:
            self.streams[trial.stream.key] = about_stream(known)
            if self._stays(trial, known, found):
                is_ok = all(run.run.status == "ok" for run in found.values() if isinstance(run, StoredRun))
                self._settled.append((trial, digest, is_ok))
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
                    self._settled = [each for each in self._settled if each[0] is not trial]
                    self._add_fault(trial, job, _not_gathered(error), digest)
            elif isinstance(run, Fault):
                self._add_fault(trial, job, run, digest)

    @staticmethod
    def _stays(trial: Trial, known: StoredTruth, found: Mapping[str, StoredRun | Fault]) -> bool:
        """Whether its rows depend on nothing but what names its jobs, and no job is to be done again."""
        runs = [found.get(job.key) for job in trial.runs]
        return (
            bool(known.digest)
            and not known.inputs
            and all(job.record is None for job in trial.runs)
            and all(
                isinstance(run, StoredRun)
                and run.run.status not in OUTSIDE
                and not run.inputs
                and run.run.digest == known.digest
                for run in runs
            )
        )

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
            divergences = Divergences(trial, self._folder)
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

    def _read_run(self, job: RunJob, known: StoredTruth, divergences: Divergences) -> StoredRun | Fault:
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
        keys = run_keys(trial, job.back_end, run.run.digest, self._kinds)
        scores = score_run(run.run, truth, reference=True) if borrowed else run.scores
        recorded = {} if job.record is None else {"record": job.record.describe()}
        row = {
            **keys,
            **scores,
            **({} if known.association is None else association_scores(known.association)),
            **outcome(run.run, run.completion, reference),
            "timed_alone": run.timed_alone,
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
        self.rows.append(row)
        self.frames.append((keys, of_frames))
        self.landmarks.append((keys, of_landmarks))

    def _add_fault(self, trial: Trial, job: RunJob, fault: Fault, digest: str = "") -> None:
        row = row_without_result(run_keys(trial, job.back_end, digest, self._kinds), fault)
        recorded = {} if job.record is None else {"record": job.record.describe()}
        self.rows.append({**row, **recorded})


def _reads_something_else(paths: Sequence[str]) -> Fault:
    names = ", ".join(sorted({Path(path).name for path in paths}))
    return Fault("missing", told(f"what it read has changed since ({names}); the same command runs it again"))


def _not_gathered(error: Exception) -> Fault:
    if isinstance(error, MemoryError):
        return Fault("missing", "there is not enough memory to read its result; the result itself is kept")
    return Fault("missing", f"its result could not be put into the tables: {describe(error)}")


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


def about_stream(known: StoredTruth) -> AboutStream:
    """What the manifest sums up of it."""
    return AboutStream(
        dict(known.front_end), tuple(known.warnings), known.truth is not None, known.error is not None
    )


def _files(trial: Trial) -> list[str]:
    """What a trial's rows are made of, by the names in the results folder."""
    return [f"streams/{trial.stream.key}.truth.npz", *(f"runs/{job.key}.npz" for job in trial.runs)]
