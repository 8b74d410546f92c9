"""Ratios and shares with their intervals as phrases, never stronger than the numbers are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from slamcmp.metrics.statistics import Interval

NARROW = 0.10
"""Half a ratio's interval up to which two that it does not tell apart are said to show no difference."""
FRACTIONS = {
    Fraction(1, 4): "a quarter",
    Fraction(1, 3): "a third",
    Fraction(1, 2): "half",
    Fraction(3, 5): "three fifths",
    Fraction(2, 3): "two thirds",
    Fraction(3, 4): "three quarters",
    Fraction(4, 5): "four fifths",
    Fraction(9, 10): "nine tenths",
}
NEAR_FRACTION = 0.03
MINUS = "−"


def told_apart(ratio: Interval) -> bool:
    """Whether the interval is there and leaves 1 out."""
    return math.isfinite(ratio.half_width) and not ratio.low <= 1.0 <= ratio.high


def change_text(ratio: Interval) -> str:
    """``2 % [−1, 5] better`` of an error's ratio below 1, ``12 % [5, 20] worse`` of one above it."""
    if ratio.estimate > 2.0:
        return f"{times_text(ratio)} worse"
    better = ratio.estimate <= 1.0
    return f"{percent_text(ratio)} {'better' if better else 'worse'}"


def percent_text(ratio: Interval) -> str:
    """``2 % [−1, 5]``: how far the ratio is from 1, counted in the estimate's own direction."""
    sign = -1.0 if ratio.estimate <= 1.0 else 1.0
    bounds = sorted(100.0 * sign * (bound - 1.0) for bound in (ratio.low, ratio.high))
    middle = 100.0 * sign * (ratio.estimate - 1.0)
    digits = _digits(middle, *bounds)
    return f"{_signed(middle, digits)} % [{', '.join(_signed(each, digits) for each in bounds)}]"


def times_text(ratio: Interval) -> str:
    """``7 ×`` where the interval is narrower than a tenth on either side, else ``7.1 × [5.0, 9.9]``."""
    low, middle, high = ratio.low, ratio.estimate, ratio.high
    digits = 0 if middle >= 5.0 else 1
    while digits < 3 and any(round(each, digits) == 1.0 for each in (low, middle, high)):
        digits += 1
    if ratio.half_width <= NARROW * middle:
        return f"{middle:.{digits}f} ×"
    return f"{middle:.{digits}f} × [{low:.{digits}f}, {high:.{digits}f}]"


def share_text(share: Interval) -> str:
    """``four fifths`` where the share is sure to a tenth and near one, else ``83 % [70, 91]``."""
    if share.half_width <= NARROW:
        nearest = min(FRACTIONS, key=lambda each: abs(float(each) - share.estimate))
        if abs(float(nearest) - share.estimate) <= NEAR_FRACTION:
            return FRACTIONS[nearest]
    low, middle, high = (100.0 * each for each in (share.low, share.estimate, share.high))
    bounds = f" [{_signed(low, 0)}, {_signed(high, 0)}]" if math.isfinite(share.half_width) else ""
    return f"{_signed(middle, 0)} %{bounds}"


def tie_text(ratios: Sequence[Interval], samples: str) -> str:
    """``no difference at 20 seeds``, or, where an interval is wide, that they cannot tell one."""
    narrow = all(max(1.0 - each.low, each.high - 1.0) <= NARROW for each in ratios)
    return f"no difference at {samples}" if narrow else f"no difference that {samples} can tell"


def listed(parts: Sequence[str], last: str = "and") -> str:
    """``a, b and c``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def capital(text: str, keep: Sequence[str] = ()) -> str:
    """With a capital, as a sentence begins; a back end's label (``keep``) stays as it is."""
    return text if any(text.startswith(each) for each in keep) else text[:1].upper() + text[1:]


def _digits(middle: float, low: float, high: float) -> int:
    """As few as keep the bounds apart from the zero that they leave out."""
    digits = 0
    while digits < 3:
        shown = [round(each, digits) for each in (low, high)]
        hidden = any(each == 0.0 for each in shown) and not low <= 0.0 <= high
        if not hidden and (round(middle, digits) != 0.0 or low <= 0.0 <= high):
            break
        digits += 1
    return digits


def _signed(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        return text.lstrip("-")
    return text.replace("-", MINUS)
