"""The grid of an experiment in its tables: back ends, swept columns, points, their rows and their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from slamcmp.results.store import Results
from slamcmp.results.words import parameters_in_words, setting_in_words


def labels(results: Results) -> list[str]:
    """Labels of the back ends, in the order of the trials table."""
    return [str(label) for label in results.trials["label"].unique()]


def swept_columns(trials: pd.DataFrame) -> list[str]:
    """The key columns that name a swept path of the configuration (``source.range_sigma_m``)."""
    return [str(column) for column in trials.columns if "." in str(column)]


def grid_points(trials: pd.DataFrame) -> list[dict[str, Any]]:
    """The distinct combinations of swept values, in the table's order; ``[{}]`` without a sweep."""
    swept = swept_columns(trials)
    if not swept:
        return [{}]
    return [
        {str(path): value for path, value in row.items()}
        for row in trials[swept].drop_duplicates().to_dict("records")
    ]


def own_columns(swept: Sequence[str], *back_ends: str) -> list[str]:
    """Of the swept columns those that change what these back ends do.

    The source and the front end concern all of them, ``back_ends.LABEL.parameter`` only its own.
    """
    return [
        path
        for path in swept
        if not path.startswith("back_ends.") or path.split(".", 1)[1].rpartition(".")[0] in back_ends
    ]


def own_points(trials: pd.DataFrame, *back_ends: str) -> set[int]:
    """Which of the :func:`grid_points` are the first with their combination of values that these have.

    Where a parameter is swept that only another back end has, their runs are the same at every value of it:
    one point stands for all.
    """
    mine = own_columns(swept_columns(trials), *back_ends)
    first: dict[tuple[str, ...], int] = {}
    for index, point in enumerate(grid_points(trials)):
        first.setdefault(tuple(value_text(point[path]) for path in mine), index)
    return set(first.values())


def at_point(table: pd.DataFrame, point: Mapping[str, Any]) -> pd.DataFrame:
    """The rows of one grid point; paths the table does not have are ignored."""
    chosen = pd.Series(True, index=table.index)
    for path, value in point.items():
        if path in table.columns:
            column = table[path]
            chosen &= column.isna() if value is None or value != value else column == value
    return table[chosen]


def middle_point(results: Results) -> dict[str, Any]:
    """The grid point in the middle of the sweep, preferring one whose runs are not all failed."""
    points = grid_points(results.trials)
    ok = [p for p in points if (at_point(results.trials, p)["status"] == "ok").any()] or points
    return ok[len(ok) // 2]


def trial_name(results: Results, trial: int) -> str:
    """``trial 3 (seed 4, range sigma = 0.1 m)``."""
    row = results.trials[results.trials["trial"] == trial].iloc[0]
    parts = [] if pd.isna(row["seed"]) else [f"seed {int(row['seed'])}"]
    if "recording" in row:
        parts = [str(row["recording"])]
    point = point_name({path: row[path] for path in swept_columns(results.trials)})
    parts += [point] if point else []
    return f"trial {trial}" + (f" ({', '.join(parts)})" if parts else "")


def point_name(point: Mapping[str, Any]) -> str:
    """``range sigma = 0.1 m``: the swept parameters in words; empty without a sweep."""
    words = parameters_in_words(point)
    return ", ".join(setting_in_words(words[path], value_text(value)) for path, value in point.items())


def value_text(value: Any) -> str:
    """A swept value as a reader writes it; a missing one stands for the configuration's null."""
    if value is None or value != value:
        return "none"
    if isinstance(value, float | np.floating):
        return f"{float(value):g}"
    return str(value)


def reference_name(results: Results) -> str:
    """``truth``, ``LABEL (final)``, or ``none``."""
    names = [str(name) for name in results.trials["reference"].dropna().unique() if name != "none"]
    return names[0] if names else "none"


def rows_of(table: pd.DataFrame, trial: int, label: str) -> pd.DataFrame:
    """The rows of one run."""
    if table.empty:
        return table
    return table[(table["trial"] == trial) & (table["label"] == label)]


def pose_dimension(frames: pd.DataFrame) -> int:
    """Of the tangent space of the poses: 3 in the plane, 6 in space."""
    return 6 if "online_err_5" in frames.columns else 3


def has_values(table: pd.DataFrame, columns: Sequence[str]) -> bool:
    """Whether every one of the columns exists and has a value somewhere."""
    return all(column in table.columns and bool(table[column].notna().any()) for column in columns)


def milliseconds_per_frame(trials: pd.DataFrame, *times: str) -> pd.Series[float]:
    """Sum of the named times [s] of each run over its finished frames, in ms; NaN where one was not taken."""
    finished = (trials["frames"] * trials["completion"]).where(lambda count: count > 0)
    total: pd.Series[float] = trials[list(times)].sum(axis=1, skipna=False) / finished * 1e3
    return total
