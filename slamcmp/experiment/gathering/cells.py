"""Rows of runs as tables: their keys, their columns, and what kind each column is."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.experiment.config.component import Component
from slamcmp.experiment.gathering.inspection import FINDINGS
from slamcmp.experiment.job.fault import Fault
from slamcmp.experiment.planning.trials import Trial
from slamcmp.metrics import metric_columns
from slamcmp.results.runs.of_runs import COST_COLUMNS

KEYS = ("trial", "label", "back_end", "seed", "digest", "own_gate")
Keyed = tuple[dict[str, Any], pd.DataFrame]
"""A run's table with the columns that are the same in all its rows."""


def run_keys(trial: Trial, choice: Component, digest: str, kinds: Mapping[str, str]) -> dict[str, Any]:
    """The columns that name a run, the same in all its rows of every table."""
    return {
        "trial": trial.number,
        "label": choice.label,
        "back_end": choice.name,
        "seed": trial.seed,
        **({"recording": trial.recording} if trial.recording else {}),
        "digest": digest,
        # Where there is a number, the run used its own choice of that stream's observations.
        "own_gate": math.nan if choice.own_gate is None else choice.own_gate,
        **{path: cell(value, kinds[path]) for path, value in trial.swept.items()},
    }


def row_without_result(keys: Mapping[str, Any], fault: Fault) -> dict[str, Any]:
    """The row of a run that left nothing but its fault."""
    return {
        **keys,
        "status": fault.status,
        "message": fault.message,
        "completion": 0.0,
        "frames": 0,
        "reference": "none",
        **dict.fromkeys(COST_COLUMNS, math.nan),
        "timed_alone": False,
        **FINDINGS,
    }


def trial_columns(trials: Sequence[Trial], found: Sequence[str]) -> list[str]:
    """Every column of the trials table; those ``found`` in rows stand behind those that are always there."""
    swept = list(trials[0].swept) if trials else []
    outcome = ["status", "message", "completion", "frames", "reference", *COST_COLUMNS, "timed_alone"]
    columns = [*KEYS, *swept, *outcome, *FINDINGS, *metric_columns()]
    return list(dict.fromkeys([*columns, *found]))


def joined(tables: Sequence[Keyed], trials: Sequence[Trial]) -> pd.DataFrame:
    """The tables of runs in one, each row with the keys of its run before it."""
    filled = [each for each in tables if len(each[1])] or list(tables[:1])
    if not filled:
        swept = list(trials[0].swept) if trials else []
        return pd.DataFrame(columns=[*KEYS, *swept])
    whole = pd.concat([table for _, table in filled], ignore_index=True)
    runs = np.repeat(np.arange(len(filled)), [len(table) for _, table in filled])
    keys = pd.DataFrame([keys for keys, _ in filled]).iloc[runs].reset_index(drop=True)
    return typed(pd.concat([keys, whole], axis=1))


def together(pieces: list[pd.DataFrame]) -> pd.DataFrame:
    """The rows of all in the order of the trials."""
    if len(pieces) == 1:
        return pieces[0]
    whole = pd.concat([each for each in pieces if len(each)] or pieces[:1], ignore_index=True)
    if whole["trial"].is_monotonic_increasing:
        return whole
    return whole.iloc[np.argsort(whole["trial"].to_numpy(), kind="stable")].reset_index(drop=True)


def names_of_rows(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The columns of rows, in the order in which they first appear."""
    return list(dict.fromkeys(name for row in rows for name in row))


def typed(table: pd.DataFrame) -> pd.DataFrame:
    """The table with whole numbers as whole numbers."""
    # Names of landmarks may take all 64 bits; a float would round them.
    whole = {"trial": "int64", "seed": "Int64", "departure_landmark": "Int64"}
    return table.astype({name: kind for name, kind in whole.items() if name in table})


def cell(value: Any, kind: str) -> Any:
    """A swept value as a column of that kind can hold it; null is a missing one."""
    if value is None:
        return math.nan if kind == "number" else None
    return json.dumps(value) if kind == "text" and not isinstance(value, str) else value
