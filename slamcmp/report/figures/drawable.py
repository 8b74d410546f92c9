"""Whether a figure can be drawn, and of which trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from slamcmp.results.grid import at_point, middle_point, swept_columns
from slamcmp.results.store import Results


class NotDrawable(Exception):
    """A figure's inputs are not in these results; the message says which and why."""


def typical_trial(results: Results) -> int:
    """The trial with the median online error among those of the middle grid point where every run is ok.

    Raises:
        NotDrawable: there is no trial.
    """
    trials = at_point(results.trials, middle_point(results))
    if trials.empty:
        raise NotDrawable("the results hold no trial")
    all_ok = (trials["status"] == "ok").groupby(trials["trial"]).all()
    candidates = trials[trials["trial"].isin(all_ok.index[all_ok])]
    if candidates.empty:
        ok = trials[trials["status"] == "ok"]
        candidates = ok if not ok.empty else trials
    if "online_ate" not in candidates or candidates["online_ate"].isna().all():
        return int(candidates["trial"].iloc[0])
    errors = candidates.groupby("trial")["online_ate"].mean().sort_values(kind="stable")
    return int(errors.index[(len(errors) - 1) // 2])


MOST_ROWS = 1_000_000
"""Of the frames' table, up to which figures take all runs: more seeds move no curve by a line's width."""


def drawn_part(results: Results) -> Results:
    """These results with the frames that figures show: where there are very many, those of the first trials.

    The trial that stands for all, then the middle grid point's up to half of :data:`MOST_ROWS`, then seed by
    seed every point's. The table of trials is whole; results of no more frames are themselves.
    """
    frames = results.frames
    if len(frames) <= MOST_ROWS:
        return results
    trials = results.trials.drop_duplicates("trial")
    shown = typical_trial(results)
    swept = swept_columns(trials)
    turn = trials.groupby(swept, dropna=False).cumcount() if swept else pd.Series(0, index=trials.index)
    everywhere = trials["trial"].iloc[np.argsort(turn.to_numpy(), kind="stable")]
    rows = frames["trial"].value_counts()
    first = _within(rows, [shown, *at_point(trials, middle_point(results))["trial"]], MOST_ROWS // 2)
    kept = _within(rows, [shown, *first, *everywhere], MOST_ROWS)
    return replace(results, frames=frames[frames["trial"].isin(kept)])


def _within(rows: pd.Series[int], trials: Sequence[int], most: int) -> list[int]:
    """As many of these trials, in order, as have no more rows together; the first one whatever it has."""
    order = list(dict.fromkeys(int(trial) for trial in trials))
    sums = rows.reindex(order, fill_value=0).cumsum().to_numpy()
    return order[: max(1, int((sums <= most).sum()))]


def part_text(part: Results, whole: Results) -> str:
    """``curves over frames: 400 of 4000 trials``, of all grid points; nothing where the part is the whole."""
    if part is whole:
        return ""
    shown, of = part.frames["trial"].nunique(), whole.frames["trial"].nunique()
    return f"curves over frames: {shown} of {of} trials"
