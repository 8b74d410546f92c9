"""How much of a Gauss-Newton step to take, told by the step before it."""

from __future__ import annotations

from slamcmp.types import FloatArray

STEEP = 1.5
"""Up to this c a whole step leaves at most half of itself, and is taken."""


def relaxed_share(step: FloatArray, last_step: FloatArray | None, last_share: float) -> float:
    """The share of ``step`` (states,) to take after ``last_share`` of the whole ``last_step``, at most 1.

    Gauss-Newton takes the cost for a parabola of its own curvature. Where the true one along a step is c
    times as large, the share a of the step leaves (1 - a c) of it to the next: above c = 1 whole steps jump
    over the minimum, above c = 2 they swing about it for ever, or outwards. The share 1/c ends at the
    minimum.
    """
    if last_step is None:
        return 1.0
    left = float(step @ last_step) / float(last_step @ last_step)
    curvature = (1.0 - left) / last_share
    return 1.0 / curvature if curvature > STEEP else 1.0
