"""Runs made in a program as the tables that an experiment leaves, for everything that reads those."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from slamcmp.errors import UsageError
from slamcmp.metrics import frame_table, landmark_table, score_run
from slamcmp.results.store import Results
from slamcmp.types import GroundTruth, Run

COST_COLUMNS = (
    "update_s",
    "estimate_s",
    "final_s",
    "peak_memory_mb",
    "estimate_wall_s",
    "estimate_processor_s",
)


def results_of_runs(runs: Sequence[Run], truth: GroundTruth | None = None) -> Results:
    """One trial: these runs of one stream, side by side.

    Raises:
        UsageError: there is none, two have the same label, or they ran on different streams.
        DataError: the truth does not belong to their stream.
    """
    labels = [run.back_end for run in runs]
    if not runs:
        raise UsageError("no run is given")
    if len(set(labels)) < len(labels):
        twice = next(label for label in labels if labels.count(label) > 1)
        raise UsageError(
            f"two runs are called {twice!r}; give one of them another name: "
            "dataclasses.replace(run, back_end=...)"
        )
    if len({run.digest for run in runs}) > 1:
        raise UsageError("the runs are of different streams, so they cannot be compared")
    rows, frames, landmarks = [], [], []
    for run in runs:
        keys: dict[str, Any] = {
            "trial": 0,
            "label": run.back_end,
            "back_end": run.back_end,
            "seed": run.seed,
            "digest": run.digest,
            "own_gate": math.nan,
        }
        reference = "none" if truth is None else "truth"
        rows.append({**keys, **score_run(run, truth), **outcome(run, run.completion, reference)})
        frames.append(frame_table(run, truth, taken=keys).assign(**keys))
        landmarks.append(landmark_table(run, truth).assign(**keys))
    config = {
        "back_ends": [{**run.parameters, "name": run.back_end, "label": run.back_end} for run in runs],
        "sweep": {},
        "seeds": [runs[0].seed],
    }
    manifest = {"name": ", ".join(labels), "config": config, "seeds": [runs[0].seed], "jobs_missing": 0}
    tables = [
        pd.concat(each, ignore_index=True).astype({"seed": "Int64"})
        for each in ([pd.DataFrame(rows)], frames, landmarks)
    ]
    return Results(Path(), manifest, *tables)


def outcome(run: Run, completion: float, reference: str) -> dict[str, Any]:
    """How a run ended and what it cost, as a row of the trials table says it."""
    return {
        "status": run.status,
        "message": run.message,
        "completion": completion,
        "frames": run.frames,
        "reference": reference,
        # Of a killed worker no times are known; zero would read as fast.
        "update_s": float(run.update_s.sum()) if run.update_s.size else math.nan,
        "estimate_s": float(run.estimate_s.sum()) if run.estimate_s.size else math.nan,
        "final_s": run.final_s,
        "peak_memory_mb": run.peak_memory_mb,
        "estimate_wall_s": run.wall_s,
        "estimate_processor_s": run.processor_s,
    }
