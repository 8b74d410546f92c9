"""Statistics of the committed runs as pages quote them: medians, and paired ratios with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from slamcmp.metrics.statistics import Interval, ratio_interval
from slamcmp.results.grid import at_point
from slamcmp.results.numbers import interval_text, number_text
from tests.anchors.reference import read_runs


class Quoted:
    """The runs of one shipped experiment at one grid point, as ``results/reference/`` has them."""

    def __init__(self, experiment: str, at: Mapping[str, Any] | None = None) -> None:
        rows = at_point(read_runs(experiment), at or {})
        assert len(rows), (experiment, at)
        self._rows = rows[rows["status"] == "ok"]

    def of(self, label: str, column: str) -> pd.Series[float]:
        """The values of one back end by seed."""
        own = self._rows[self._rows["label"] == label]
        assert len(own), label
        return own.set_index("seed")[column].dropna()

    def median(self, label: str, column: str) -> str:
        """Over the runs that are ok, three digits."""
        return number_text(float(self.of(label, column).median()))

    def ratio(self, label: str, other: str, column: str, other_column: str | None = None) -> Interval:
        """Geometric mean of the paired ratio of one back end to another."""
        pairs = pd.concat([self.of(label, column), self.of(other, other_column or column)], axis=1).dropna()
        return ratio_interval(*pairs.to_numpy(float).T)

    def times(
        self, label: str, other: str, column: str, other_column: str | None = None, *, differs: bool
    ) -> str:
        """``1.39 times (1.17 to 1.66)``, of two that the page says to differ, or not to be told apart."""
        ratio = self.ratio(label, other, column, other_column)
        assert (not ratio.low <= 1.0 <= ratio.high) == differs, (label, other, column, ratio)
        return f"{number_text(ratio.estimate)} times ({interval_text(ratio)})"
