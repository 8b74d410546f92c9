"""Whether odometry and truth have the same clock: at which offset do their rates go together best?

Speeds and yaw rates of both are correlated over offsets. What hardly varies says nothing: of noise alone the
largest correlation of many offsets is told from a chance level. The offset's standard error is that of the
jackknife over blocks of time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from slamcmp.types import FloatArray

LARGE_S = 0.03
SHARE_OF_STEP = 0.1
"""Between two stamps a rate is constant: what lies between is resolved to a tenth of their distance."""
CHANCE = 4.0
"""Correlations of noise lie within so many of their standard deviations, the largest of 400 too."""
ERRORS = 3.0
BLOCKS = 10
STILL = 1e-6
"""Standard deviation [m/s or rad/s] of rates that do not vary at all."""


@dataclass(frozen=True)
class ClockOffset:
    """How far the odometry's clock is ahead of the truth's."""

    misfit: FloatArray
    """At each offset that was tried: one minus the correlation, summed over the rates that tell something."""
    offset_s: float
    """At the smallest; 0 where nothing tells."""
    error_s: float
    """Its standard error; infinite where nothing tells."""
    resolved_s: float
    """From here on it is an offset."""

    @property
    def tells(self) -> bool:
        """Whether the rates vary enough."""
        return math.isfinite(self.error_s)

    @property
    def is_large(self) -> bool:
        """Whether the clocks are off."""
        return self.tells and abs(self.offset_s) >= self.resolved_s


def clock_offset(
    own: Sequence[FloatArray],
    theirs: Callable[[float], Sequence[FloatArray]],
    offsets_s: FloatArray,
    duration_s: float,
    step_s: float,
) -> ClockOffset:
    """The offset at which rates go together.

    Args:
        own: of the odometry, (n,) each, at instants that are evenly apart.
        theirs: of the truth, alike, at the same instants by its clock and an offset [s].
        offsets_s: those that are tried, (m,).
        duration_s: time that the instants span.
        step_s: the odometry's usual step; its rates are constant over it.
    """
    columns = [theirs(offset) for offset in offsets_s.tolist()]
    chance = CHANCE / math.sqrt(max(1.0, duration_s / step_s))
    whole, without = np.zeros(offsets_s.size), np.zeros((BLOCKS, offsets_s.size))
    telling = 0
    for number, mine in enumerate(own):
        sums = np.stack([_sums(mine, each[number]) for each in columns], axis=1)
        all_of_it = _correlation(sums.sum(axis=0))
        if all_of_it.max() <= chance:
            continue
        telling += 1
        whole += 1.0 - all_of_it
        without += 1.0 - _correlation(sums.sum(axis=0) - sums)
    if not telling:
        return ClockOffset(np.ones(offsets_s.size), 0.0, math.inf, math.inf)
    best = offsets_s[np.argmin(without, axis=1)]
    error = math.sqrt((BLOCKS - 1) / BLOCKS * float(((best - best.mean()) ** 2).sum()))
    resolved = max(LARGE_S, SHARE_OF_STEP * step_s, ERRORS * error)
    return ClockOffset(whole, float(offsets_s[int(np.argmin(whole))]), error, resolved)


def _sums(a: FloatArray, b: FloatArray) -> FloatArray:
    """What a correlation is made of, of each block, (BLOCKS, 6)."""
    # About their means, or squares of large numbers would hide what varies.
    a, b = a - a.mean(), b - b.mean()
    terms = np.stack([np.ones_like(a), a, b, a * a, b * b, a * b], axis=-1)
    return np.stack([part.sum(axis=0) for part in np.array_split(terms, BLOCKS)])


def _correlation(sums: FloatArray) -> FloatArray:
    """Of sums (…, 6); 0 where one of the two does not vary."""
    n, a, b, aa, bb, ab = np.moveaxis(sums, -1, 0)
    of_a, of_b = aa / n - (a / n) ** 2, bb / n - (b / n) ** 2
    varies = (of_a > STILL**2) & (of_b > STILL**2)
    product = np.where(varies, of_a * of_b, 1.0)
    found: FloatArray = np.where(varies, (ab / n - a * b / n**2) / np.sqrt(product), 0.0)
    return found
