"""Numbers and intervals as a table shows them."""

from __future__ import annotations

import numpy as np

from slamcmp.metrics.statistics import Interval


def number_text(value: float) -> str:
    """Three significant digits, plain where that is readable."""
    if abs(value) < 1e-12:
        # What rounding leaves of the reference's difference from itself.
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
        return f"{value:.{digits}f}"
    return f"{value:.2e}"


def interval_text(interval: Interval) -> str:
    """``0.0912 to 0.113``; empty where the runs are too few for an interval."""
    if not np.isfinite([interval.low, interval.high]).all():
        return ""
    return f"{number_text(interval.low)} to {number_text(interval.high)}"


def share_text(interval: Interval) -> str:
    """``5 % (1 to 24 %)``."""
    rate, low, high = (100.0 * each for each in (interval.estimate, interval.low, interval.high))
    return f"{rate:.0f} % ({low:.0f} to {high:.0f} %)"
