"""Finished runs gathered into the three tables."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from slamcmp.errors import SlamcmpError
from slamcmp.experiment.config.component import Component
from slamcmp.experiment.inspection import FINDINGS, Inspector
from slamcmp.experiment.job.task import posteriors_path, run_path, stream_path, truth_path
from slamcmp.experiment.samples import Samples
from slamcmp.experiment.trials import RunJob, Trial
from slamcmp.metrics import frame_table, landmark_table, metric_columns, reference_truth, score_run
from slamcmp.metrics.information import KL, last_kl, median_kl
from slamcmp.results.of_runs import COST_COLUMNS, outcome
from slamcmp.results.posteriors import kl_series, load_posteriors
from slamcmp.results.run_file import StoredRun, StoredTruth, load_run, load_truth, relabelled
from slamcmp.types import GroundTruth

KEYS = ("trial", "label", "back_end", "seed", "digest", "own_gate")


def gather(
    trials: Sequence[Trial], folder: Path, reference: str | None, stream_faults: Mapping[str, str]
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The trials, frames and landmarks of every run that lies in the folder.

    ``stream_faults`` holds, by stream key, why a stream could not be made: its runs become failed rows.

    Raises:
        SlamcmpError: back ends of one trial did not get the same stream.
        UsageError: two samples are one and the same stream.
    """
    rows: list[dict[str, Any]] = []
    frames: list[pd.DataFrame] = []
    landmarks: list[pd.DataFrame] = []
    kinds = _kinds(trials)
    samples = Samples()
    for trial in trials:
        if trial.stream.key in stream_faults:
            rows += [
                _row_without_stream(_keys(trial, job.back_end, "", kinds), stream_faults[trial.stream.key])
                for job in trial.runs
            ]
            continue
        known = load_truth(truth_path(folder, trial.stream.key))
        divergences = _Divergences(trial, folder)
        stored = [
            (job.back_end, divergences.added(job, relabelled(run, job.back_end.label)))
            for job in trial.runs
            if (run := load_run(run_path(folder, job.key))) is not None
        ]
        if known is None or not stored:
            continue
        _require_one_stream(trial, known, [run for _, run in stored])
        samples.add(trial, known.digest)
        truth, name = trial_truth(known, [run for _, run in stored], reference)
        borrowed = truth is not None and known.truth is None
        record = trial.runs[0].record
        recorded = {} if record is None else {"record": record.describe()}
        inspector = Inspector(stream_path(folder, known.digest), truth, borrowed, known.own_ids)
        for choice, run in stored:
            keys = _keys(trial, choice, known.digest, kinds)
            scores = score_run(run.run, truth, reference=True) if borrowed else run.scores
            rows.append(
                {
                    **keys,
                    **scores,
                    **outcome(run.run, run.completion, name),
                    **inspector.findings(run.run),
                    **recorded,
                }
            )
            of_frames = frame_table(run.run, truth, reference=borrowed, taken=keys)
            of_landmarks = landmark_table(run.run, truth, reference=borrowed)
            if known.own_ids is not None:
                of_landmarks["id"] = known.own_ids[of_landmarks["id"].to_numpy()]
            for tables, table in ((frames, of_frames), (landmarks, of_landmarks)):
                for position, (key, value) in enumerate(keys.items()):
                    table.insert(position, key, value)
                tables.append(table)
    return (
        _typed(pd.DataFrame(rows, columns=_columns(trials, rows))),
        _joined(frames, trials),
        _joined(landmarks, trials),
    )


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


def _require_one_stream(trial: Trial, known: StoredTruth, runs: Sequence[StoredRun]) -> None:
    digests = {run.run.digest for run in runs} | {known.digest}
    if len(digests) > 1:
        raise SlamcmpError(
            f"trial {trial.number}: its back ends ran on different streams "
            f"({', '.join(sorted(digest[:12] for digest in digests))}), so their results cannot be compared; "
            "the source or the front end does not repeat itself: delete the results folder and make them "
            "depend on nothing but the seed"
        )


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


def _row_without_stream(keys: Mapping[str, Any], fault: str) -> dict[str, Any]:
    return {
        **keys,
        "status": "crashed",
        "message": f"no stream: {fault}",
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
    return table.astype({"trial": "int64", "seed": "Int64"})


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
