"""Which runs left what their own covariances allow, and when: a line for each back end."""

from __future__ import annotations

from slamcmp.results.grid import labels
from slamcmp.results.store import Results

TESTS = {
    "NIS": "its innovations",
    "NEES": "its error against the truth",
    "MAP": "its map, which moved away from where it had been",
}
"""What gave a departure away."""


def departure_lines(results: Results) -> list[str]:
    """``EKF: 3 of 20 runs, first at frame 212 of trial 4 (its innovations)``, of each label that has any."""
    trials = results.trials
    if "departure_frame" not in trials.columns:
        return []
    lines = []
    for label in labels(results):
        own = trials[trials["label"] == label]
        left = own[own["departure_frame"].notna()]
        if left.empty:
            continue
        first = left.iloc[int(left["departure_frame"].to_numpy(dtype=float).argmin())]
        runs = "the run" if len(own) == 1 else f"{len(left)} of {len(own)} runs"
        where = f"{'at' if len(left) == 1 else 'first at'} frame {int(first['departure_frame'])}"
        if len(own) > 1:
            where += f" of trial {int(first['trial'])}"
        lines.append(f"{label}: {runs}, {where} ({TESTS[str(first['departure_test'])]})")
    return lines
