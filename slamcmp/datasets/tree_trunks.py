"""Tree trunks in a planar laser scan: near-by returns that stand alone and are as wide as a trunk.

A trunk is a run of neighbouring beams that end at one place, with open space, or something farther, to both
sides. Where something nearer stands beside it, part of the trunk is hidden and its middle is not known, so it
is left out; so are runs that go deep (walls and hedges seen at an angle) or are too wide.

========  =================================================================
symbol    meaning
========  =================================================================
r         ranges of a scan, (beams,) [m]
d         diameter, the run's angle times its range [m]
========  =================================================================

The surface that beams hit is on average pi/4 of the radius nearer than the trunk's middle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slamcmp.types import FloatArray


class TrunkSize(NamedTuple):
    """What counts as a trunk."""

    nearest_m: float = 1.5
    """Nearer returns are of the vehicle itself."""
    farthest_m: float = 35.0
    thinnest_m: float = 0.1
    thickest_m: float = 1.2
    beams: int = 2
    """Fewest beams that hit it."""


JUMP_M = 0.4
"""Beside one another, two beams that differ by less end at one thing."""
ALONE_M = 1.0
"""By how much what is seen beside a trunk must be farther."""
DEEP = 0.6
"""Largest depth of what is seen of a trunk, as a share of its diameter, beyond the scanner's noise."""
NOISE_M = 0.1


def find_trunks(r: FloatArray, bearings: FloatArray, size: TrunkSize) -> FloatArray:
    """Range and bearing of the middle of each trunk, and its diameter, (m, 3), by bearing.

    Args:
        r: ranges (beams,) [m]; what is not finite, or not within the size's, is no return.
        bearings: of the beams (beams,) [rad], evenly ascending.
        size: what counts as a trunk.
    """
    beam = float(bearings[1] - bearings[0])
    seen = np.isfinite(r) & (r > size.nearest_m) & (r < size.farthest_m)
    reach = np.where(seen, r, np.inf)
    # What is too near is no trunk, and hides what is behind.
    reach[np.isfinite(r) & (r <= size.nearest_m)] = 0.0
    with np.errstate(invalid="ignore"):
        broken = ~(np.abs(np.diff(reach)) < JUMP_M)
    starts = np.concatenate([[0], np.flatnonzero(broken) + 1])
    ends = np.concatenate([starts[1:], [r.size]])
    found = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        count = end - start
        if count < size.beams or not seen[start]:
            continue
        run = reach[start:end]
        surface = float(run.mean())
        diameter = surface * count * beam
        before = reach[start - 1] if start else 0.0
        after = reach[end] if end < r.size else 0.0
        if (
            size.thinnest_m <= diameter <= size.thickest_m
            and min(before, after) > run.max() + ALONE_M
            and float(np.ptp(run)) <= DEEP * diameter + NOISE_M
        ):
            middle = surface + 0.5 * diameter * math.pi / 4.0
            found.append((middle, float(bearings[start:end].mean()), diameter))
    return np.array(found).reshape(-1, 3)
