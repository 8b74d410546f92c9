"""How back ends, intervals and times are put into words."""

from __future__ import annotations

import math

from slamcmp.advice.evidence import told_apart
from slamcmp.advice.ladder import ODOMETRY
from slamcmp.metrics.statistics import Interval
from slamcmp.results.numbers import number_text

FRACTIONS = {
    2: "half", 3: "a third of", 4: "a quarter of", 5: "a fifth of", 6: "a sixth of", 7: "a seventh of",
    8: "an eighth of", 9: "a ninth of", 10: "a tenth of",
}  # fmt: skip
ALIKE = 1.1
"""Times that differ by less are called about the same: nobody chooses by it."""
TWICE = 2.0
"""From here on an error is told as a multiple, below as a percentage."""


def capital(text: str) -> str:
    """As a sentence begins; a name that has its capital elsewhere keeps it (iSAM2)."""
    return text if text[1:2].isupper() else text[0].upper() + text[1:]


def the(label: str) -> str:
    """``the EKF``, ``a window of 10``, ``iSAM2``."""
    if label.startswith("window"):
        return f"a {label}"
    if label == ODOMETRY:
        return "odometry alone"
    return f"the {label}" if "EKF" in label else label


def percent(ratio: Interval) -> str:
    """How far above 1, or below: ``3 % [1, 5]``; from 2 on ``2.4 times [2.1, 2.7]``."""
    if ratio.estimate >= TWICE:
        return f"{number_text(ratio.estimate)} times [{number_text(ratio.low)}, {number_text(ratio.high)}]"
    sign = 1.0 if ratio.estimate >= 1.0 else -1.0
    low, high = sorted((100.0 * sign * (ratio.low - 1.0), 100.0 * sign * (ratio.high - 1.0)))
    value = 100.0 * sign * (ratio.estimate - 1.0)
    digits = 0 if high - low >= 2.0 else 1 if high - low >= 0.2 else 2
    return f"{_plain(value, digits)} % [{_plain(low, digits)}, {_plain(high, digits)}]"


def more_or_less(ratio: Interval) -> str:
    """``has 12 % [8, 15] less error than``, ``has 2.4 times [2.1, 2.7] the error of``."""
    if ratio.estimate >= TWICE:
        return f"has {percent(ratio)} the error of"
    return f"has {percent(ratio)} {'more' if ratio.estimate >= 1.0 else 'less'} error than"


def time_words(ratio: Interval) -> str:
    """``at an eighth of the time``, ``at 2.5 times the time``, ``in about the same time``."""
    value = ratio.estimate
    if not math.isfinite(value):
        return "in a time that was not measured"
    if 1.0 / ALIKE <= value <= ALIKE or (math.isfinite(ratio.half_width) and not told_apart(ratio)):
        return "in about the same time"
    if value > 1.0:
        return f"at {value:.2g} times the time" if value < 10 else f"at {value:.0f} times the time"
    parts = round(1.0 / value)
    if parts in FRACTIONS and abs(1.0 / value / parts - 1.0) < 0.15:
        return f"at {FRACTIONS[parts]} the time"
    return f"at {value:.2g} of the time" if value > 0.1 else f"at 1/{parts} of the time"


def listed(names: list[str]) -> str:
    """``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def ratio_text(ratio: Interval) -> str:
    bounds = "" if ratio.low != ratio.low else f" [{number_text(ratio.low)}, {number_text(ratio.high)}]"
    return f"{number_text(ratio.estimate)}{bounds}"


def signed(ratio: Interval) -> str:
    """``+0.3 % [−0.5, 1.1]``."""
    low, value, high = (100.0 * (each - 1.0) for each in (ratio.low, ratio.estimate, ratio.high))
    digits = 0 if high - low >= 2.0 else 1 if high - low >= 0.2 else 2
    texts = [f"{each:.{digits}f}" for each in (value, low, high)]
    value_text, low_text, high_text = (
        text.lstrip("-") if float(text) == 0.0 else text.replace("-", "−") for text in texts
    )
    plus = "+" if float(texts[0]) > 0 else ""
    return f"{plus}{value_text} % [{low_text}, {high_text}]"


def _plain(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text[1:] if float(text) == 0.0 and text.startswith("-") else text.replace("-", "−")
