"""Whether a figure can be drawn, and of which trial."""

from __future__ import annotations

from dataclasses import replace

from slamcmp.results.grid import at_point, middle_point
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

    Of the middle grid point, which is what figures over frames show, with the trial that stands for it. The
    table of trials is whole; results of :data:`MOST_ROWS` frames or fewer are themselves.
    """
    frames = results.frames
    if len(frames) <= MOST_ROWS:
        return results
    rows = frames["trial"].value_counts()
    shown = typical_trial(results)
    others = at_point(results.trials, middle_point(results))["trial"].drop_duplicates()
    order = [shown, *(int(trial) for trial in others if trial != shown)]
    sums = rows.reindex(order, fill_value=0).cumsum()
    kept = sums.index[(sums <= MOST_ROWS) | (sums.index == shown)]
    return replace(results, frames=frames[frames["trial"].isin(kept)])


def part_text(part: Results, whole: Results) -> str:
    """``curves over frames: 400 of 4000 trials``, of all grid points; nothing where the part is the whole."""
    if part is whole:
        return ""
    shown, of = part.frames["trial"].nunique(), whole.frames["trial"].nunique()
    return f"curves over frames: {shown} of {of} trials"
