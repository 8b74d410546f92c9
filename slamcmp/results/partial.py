"""Which runs of an experiment are missing from its tables, and what can be compared all the same."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from slamcmp.results.grid import at_point, grid_points, point_name, swept_columns
from slamcmp.results.store import Results

NOT_RUN = ("missing", "killed")
"""Statuses of rows that say nothing about the back end: its run is not there, or was ended from outside."""
LISTED = 6
"""Missing runs of a back end up to which each is named."""


@dataclass(frozen=True)
class Missing:
    """What an interrupted or damaged experiment lacks."""

    runs: pd.DataFrame
    """One row a missing run: its swept values, ``seed``, ``label``, and of recordings which ``recording``."""
    asked: int
    """Runs that the experiment asks for."""
    compared: int
    """Trials in which every back end has its run; comparisons use these only."""
    trials: int
    """That the experiment asks for."""

    def sentence(self) -> str:
        """How many, and which: ``not complete: 3 of 20 runs are missing (EKF: seeds 3, 4; batch: …)…``."""
        parts = [f"{label}: {_named(own)}" for label, own in self.runs.groupby("label", sort=False)]
        return (
            f"not complete: {len(self.runs)} of {self.asked} runs are missing ({'; '.join(parts)}); "
            f"back ends are compared on the {self.compared} of {self.trials} trials that all of them have"
        )

    def short(self) -> str:
        """For the title of a figure."""
        return (
            f"not complete: {len(self.runs)} of {self.asked} runs are missing; shown are the {self.compared} "
            f"of {self.trials} trials that all back ends have"
        )

    def of(self, label: str, point: Mapping[str, Any]) -> int:
        """Missing runs of one back end at one grid point."""
        own = self.runs[self.runs["label"] == label]
        return sum(
            all(
                _cell(value) in (_cell(row[path]), _cell(json.dumps(row[path])))
                for path, value in point.items()
            )
            for row in own.to_dict("records")
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "runs": len(self.runs),
            "asked": self.asked,
            "compared_trials": self.compared,
            "trials": self.trials,
            "which": self.runs.astype(object).where(self.runs.notna(), None).to_dict("records"),
        }


def missing_runs(results: Results) -> Missing | None:
    """What the experiment's own configuration asks for and the tables do not hold; None where nothing is."""
    config = results.manifest.get("config") or {}
    sweep: Mapping[str, Any] = config.get("sweep") or {}
    names = [str(entry["label"]) for entry in config.get("back_ends") or [] if "label" in entry]
    if not names:
        return _without_configuration(results)
    recordings: list[str] = results.manifest.get("recordings") or []
    seeds = (
        list(range(len(recordings)))
        or results.manifest.get("seeds")
        or config.get("seeds")
        or results.trials["seed"].unique().tolist()
    )
    ran = results.trials[~results.trials["status"].isin(NOT_RUN)]
    there = {
        (*(_cell(value) for value in row[:-1]), str(row[-1]))
        for row in ran.reindex(columns=[*sweep, "seed", "label"]).itertuples(index=False, name=None)
    }
    rows, trials = [], 0
    for values in itertools.product(*sweep.values()):
        points = list(itertools.product(*({_cell(value), _cell(json.dumps(value))} for value in values)))
        for seed in seeds:
            trials += 1
            rows += [
                {
                    **dict(zip(sweep, values, strict=True)),
                    "seed": seed,
                    "label": name,
                    **({"recording": recordings[seed]} if recordings else {}),
                }
                for name in names
                if not any((*point, _cell(seed), name) in there for point in points)
            ]
    if not rows:
        return None
    named = ["recording"] if recordings else []
    runs = pd.DataFrame(rows, columns=[*sweep, "seed", "label", *named]).astype({"seed": "Int64"})
    return Missing(runs, trials * len(names), len(_whole_trials(results)), trials)


def comparable(results: Results) -> Results:
    """The trials in which every back end has a run: of these alone medians may stand side by side.

    A back end without any run at a grid point costs the others nothing there. Where nothing is missing these
    are the results themselves.
    """
    if missing_runs(results) is None:
        return results
    whole = _whole_trials(results)
    ran = results.trials[~results.trials["status"].isin(NOT_RUN)]

    def rows(table: pd.DataFrame) -> pd.DataFrame:
        return table[table["trial"].isin(whole)] if "trial" in table else table

    return replace(results, trials=rows(ran), frames=rows(results.frames), landmarks=rows(results.landmarks))


def _without_configuration(results: Results) -> Missing | None:
    """By the rows alone: those that say so themselves."""
    lost = results.trials["status"].isin(NOT_RUN)
    if not lost.any():
        return None
    runs = results.trials.loc[lost, [*swept_columns(results.trials), "seed", "label"]]
    trials = int(results.trials["trial"].nunique())
    return Missing(runs, len(results.trials), len(_whole_trials(results)), trials)


def _whole_trials(results: Results) -> set[int]:
    """Trials in which every back end that ran at their grid point has a run."""
    ran = results.trials[~results.trials["status"].isin(NOT_RUN)]
    whole: set[int] = set()
    for point in grid_points(ran):
        here = at_point(ran, point)
        counts = here.groupby("trial")["label"].nunique()
        whole |= {int(trial) for trial in counts.index[counts == here["label"].nunique()]}
    return whole


def _cell(value: Any) -> Any:
    """Something to compare: every missing value alike, infinities and lists as the text that files hold."""
    if value is None or value is pd.NA:
        return None
    if isinstance(value, list | tuple | dict):
        return json.dumps(value)
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def _named(own: pd.DataFrame) -> str:
    """``seed 3, seed 4`` or the recordings, with the grid point if there is one; ``12 runs`` of many."""
    swept = swept_columns(own)
    if len(own) > LISTED or (own["seed"].isna().any() and not swept):
        return f"{len(own)} run{'s' if len(own) > 1 else ''}"
    texts = []
    for row in own.to_dict("records"):
        seed = row.get("recording") or ("" if pd.isna(row["seed"]) else f"seed {int(row['seed'])}")
        place = point_name({path: row[path] for path in swept})
        texts.append(" at ".join(part for part in (seed, place) if part))
    return ", ".join(texts)
