"""Whether a figure can be drawn, and of which trial."""

from __future__ import annotations

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
