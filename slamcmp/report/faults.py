"""The runs that failed or left their band, with the reason that was found."""

from __future__ import annotations

import pandas as pd

from slamcmp.results.grid import swept_columns
from slamcmp.results.store import Results

SHOWN = 40
"""Rows beyond which a reader stops reading; the trials table holds all."""


def fault_table(results: Results) -> tuple[pd.DataFrame, int]:
    """One row a run that is not ok or shows a departure, failed ones first; and how many are left out."""
    trials = results.trials
    if "diagnosis" not in trials.columns:
        return pd.DataFrame(), 0
    told = trials[(trials["diagnosis"].fillna("") != "") | (trials["status"] != "ok")]
    told = told.sort_values(by="status", key=lambda status: status == "ok", kind="stable")
    table = pd.DataFrame(
        {
            "trial": told["trial"],
            "seed": told["seed"],
            **{path: told[path] for path in swept_columns(trials)},
            "back end": told["label"],
            "status": told["status"],
            "first frame": told["departure_frame"].astype("Int64"),
            "what happened": told["diagnosis"].where(
                told["diagnosis"].fillna("") != "", "Nothing that it computed was kept."
            ),
        }
    )
    return table.head(SHOWN), max(0, len(table) - SHOWN)
