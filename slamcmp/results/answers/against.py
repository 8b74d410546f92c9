"""Each back end's errors over the first one's, run by run on the same stream: what answers are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slamcmp.metrics.statistics import Interval, ratio_interval
from slamcmp.results.answers.phrases import told_apart
from slamcmp.results.grid import at_point, grid_points, labels, own_columns, own_points, swept_columns
from slamcmp.results.judgements.summary import ENOUGH_SEEDS, errors_by_trial, warm_started
from slamcmp.results.store import Results

SPELT = 3
"""Back ends that differ from the first one up to which each is named with its interval, on either side."""


@dataclass(frozen=True)
class Against:
    """The error of a back end over that of another one, on their common streams at a grid point."""

    label: str
    other: str
    point: Mapping[str, Any]
    ratio: Interval

    @property
    def verdict(self) -> str:
        """``better``, ``worse``, ``tie``, or ``too few`` runs."""
        if self.ratio.runs < ENOUGH_SEEDS or not math.isfinite(self.ratio.half_width):
            return "too few"
        if not told_apart(self.ratio):
            return "tie"
        return "better" if self.ratio.estimate < 1.0 else "worse"


def comparisons(results: Results, which: str) -> list[Against]:
    """Every back end with an ``online`` or ``final`` error against the first one that has it.

    A pair is compared once for each combination of the swept values that one of the two has. Batch solvers
    that solve once have no online error of their own.
    """
    table = results.trials
    if which == "online":
        table = table[~table["label"].isin(warm_started(results))]
    column = f"{which}_ate"
    known = [
        label
        for label in labels(results)
        if not errors_by_trial(table[table["label"] == label], column).empty
    ]
    found = []
    for label in known[1:]:
        here = own_points(results.trials, known[0], label)
        mine = own_columns(swept_columns(results.trials), known[0], label)
        for index, point in enumerate(grid_points(results.trials)):
            if index in here:
                errors = errors_by_trial(at_point(table, point), column).reindex(columns=[known[0], label])
                ratio = ratio_interval(errors[label], errors[known[0]])
                found.append(Against(label, known[0], {path: point[path] for path in mine}, ratio))
    return found


def samples_text(results: Results, count: int) -> str:
    """``20 seeds``, ``one seed``, ``5 recordings``."""
    trials = results.trials
    kind = "recording" if "recording" in trials or trials["seed"].isna().all() else "seed"
    return f"one {kind}" if count == 1 else f"{count} {kind}s"


def by_label(found: list[Against]) -> list[tuple[str, list[Against]]]:
    """The comparisons of each back end, in order."""
    names = list(dict.fromkeys(each.label for each in found))
    return [(label, [each for each in found if each.label == label]) for label in names]
