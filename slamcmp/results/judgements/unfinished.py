"""The runs that are in no number of a table: failed ones with their message, and those that are missing."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from slamcmp.results.grid import swept_columns, value_text
from slamcmp.results.partial import NOT_RUN, missing_runs
from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words

LISTED = 50


def unfinished_runs(results: Results, most: int = LISTED) -> tuple[list[str], int]:
    """A line for each run that failed or is missing, and how many more there are than ``most``.

    ``EKF, seed 4, range sigma [m] 2: diverged: covariance is not finite``.
    """
    trials = results.trials
    failed = trials[(trials["status"] != "ok") & ~trials["status"].isin(NOT_RUN)]
    lines = [
        ": ".join(filter(None, [_name(row, results), str(row["status"]), str(row.get("message") or "")]))
        for row in failed.to_dict("records")
    ]
    missing = missing_runs(results)
    if missing is not None:
        lines += [f"{_name(row, results)}: missing" for row in missing.runs.to_dict("records")]
    return lines[:most], max(0, len(lines) - most)


def _name(row: Mapping[Hashable, Any], results: Results) -> str:
    swept = swept_columns(results.trials)
    words = parameters_in_words(swept)
    seed = row.get("recording") or ("" if pd.isna(row["seed"]) else f"seed {row['seed']}")
    values = [f"{words[path]} {value_text(row[path])}" for path in swept if path in row]
    return ", ".join([str(row["label"]), *filter(None, [str(seed)]), *values])
