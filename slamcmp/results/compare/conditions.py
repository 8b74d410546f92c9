"""``online_ate worse by 5%``: when a comparison is to fail a build.

A condition reads ``METRIC worse|better|differs by [more than] NUMBER[%|UNIT]``, the metric by its name or
as tables head it (``online ATE``). With % it is about the ratio of the two
(geometric mean over the pairs): an error is 5 % worse above 1.05 and 5 % better below 0.95 times the other.
With the metric's unit it is about their difference (median over the pairs).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from slamcmp.errors import UsageError
from slamcmp.metrics import MetricColumn
from slamcmp.registry import did_you_mean

GRAMMAR = "METRIC worse|better|differs by X% or X UNIT, e.g. 'online_ate worse by 5%' or '… by 0.01 m'"
_CONDITION = re.compile(
    r"(?P<metric>\S.*?)\s+(?P<direction>\S+)\s+by\s+(?:(?:more\s+than|over)\s+|>\s*)?(?P<amount>[0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*(?P<unit>\S*)"
)
DIRECTIONS = ("worse", "better", "differs")
SCALES = {"m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3}, "s": {"s": 1.0, "ms": 1e-3}, "ms": {"ms": 1.0, "s": 1e3}}
"""Units that a difference may be given in, by the metric's own."""


@dataclass(frozen=True)
class Condition:
    """When a comparison fails."""

    text: str
    metric: str
    direction: str
    """One of :data:`DIRECTIONS`."""
    amount: float
    """A share where :attr:`relative`, else in the metric's unit."""
    relative: bool

    def beyond(self, low: float, high: float, *, lower_is_better: bool | None) -> bool:
        """Whether everything from ``low`` to ``high`` (ratio or difference) is past the amount."""
        up, down = self._limits()
        higher, lower = low > up, high < down
        if self.direction == "differs":
            return higher or lower
        bad_is_up = lower_is_better is not False
        return higher if bad_is_up == (self.direction == "worse") else lower

    def _limits(self) -> tuple[float, float]:
        """Ratio or difference above and below which the amount is exceeded."""
        if not self.relative:
            return self.amount, -self.amount
        return 1.0 + self.amount, 1.0 - self.amount


def _named(text: str, metrics: Mapping[str, MetricColumn]) -> str:
    """The metric's name, also of its heading; what is neither stays as it is."""
    if text in metrics:
        return text
    known = {_key(f"{each.trajectory} {each.header}"): name for name, each in metrics.items()}
    return {**known, **{_key(name): name for name in metrics}}.get(_key(text), text)


def _key(text: str) -> str:
    """Small letters and digits: case, spaces and a unit in brackets do not matter."""
    return re.sub(r"[^a-z0-9χ²]+", "_", re.sub(r"\[.*?\]", "", text.lower())).strip("_")


def parse_condition(text: str, metrics: Mapping[str, MetricColumn]) -> Condition:
    """A condition from the command line.

    Raises:
        UsageError: it does not read as one, there is no such metric, the metric has no better and worse, or
            the unit is not the metric's.
    """
    where = f"--fail-if {text!r}"
    match = _CONDITION.fullmatch(text.strip())
    if match is None:
        raise UsageError(f"{where}: expected {GRAMMAR}")
    metric, direction, unit = _named(match["metric"], metrics), match["direction"], match["unit"]
    if metric not in metrics:
        raise UsageError(f"{where}: there is no metric {metric!r}{did_you_mean(metric, metrics)}")
    if direction not in DIRECTIONS:
        raise UsageError(f"{where}: {direction!r} is not one of {', '.join(DIRECTIONS)}")
    about = metrics[metric]
    if direction != "differs" and about.lower_is_better is None:
        raise UsageError(f"{where}: {metric} has no better and worse; say '{metric} differs by …'")
    amount = float(match["amount"])
    # Of RPE per metre, which is in %, it is the ratio that is meant, as of any other.
    if unit == "%":
        return Condition(text, metric, direction, amount / 100.0, True)
    scales = {"": 1.0} if about.unit == "1" else SCALES.get(about.unit, {about.unit: 1.0})
    if unit not in scales:
        known = " or ".join(name or "no unit" for name in scales)
        raise UsageError(f"{where}: {metric} is in {known}, so the amount is in {known} or in %")
    return Condition(text, metric, direction, amount * scales[unit], False)
