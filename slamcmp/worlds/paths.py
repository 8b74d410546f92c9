"""True paths as piecewise constant controls, so that loops close exactly.

A path is a list of legs (straight lines and arcs) driven over and over, or a walk between random waypoints.
Controls are (K-1, 2): speed [m/s] and turn rate [rad/s], each held for one time step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slamcmp.errors import UsageError
from slamcmp.geometry import wrap
from slamcmp.models.motion import Unicycle
from slamcmp.types import FloatArray

FARTHEST = 1.2
"""Of a square's half side: from its middle a twentieth of the area is farther away, of 1.42 nothing."""


@dataclass(frozen=True)
class Leg:
    """A straight line (``angle_rad`` 0) or an arc, driven at constant speed and turn rate."""

    length_m: float
    angle_rad: float = 0.0


def drive(legs: Sequence[Leg], steps: int, speed_m_s: float, time_step_s: float) -> FloatArray:
    """Controls (steps-1, 2) that repeat the legs in order.

    Each leg takes a whole number of steps, at ``speed_m_s`` or a little less, so that a closed course stays
    closed.
    """
    rows: list[tuple[float, float]] = []
    for leg in legs:
        # The small number keeps a length that is a whole number of steps from gaining one by rounding.
        count = max(1, math.ceil(leg.length_m / (speed_m_s * time_step_s) - 1e-9))
        duration = count * time_step_s
        rows += [(leg.length_m / duration, leg.angle_rad / duration)] * count
    lap = np.array(rows)
    return lap[np.arange(steps - 1) % len(lap)]


def arc(angle_rad: float, radius_m: float) -> Leg:
    """An arc of the given radius; positive angles turn left."""
    return Leg(abs(angle_rad) * radius_m, angle_rad)


def stadium(length_m: float, radius_m: float) -> list[Leg]:
    """There along the x axis, half a turn to the left, back, and half a turn again."""
    half = arc(math.pi, radius_m)
    return [Leg(length_m), half, Leg(length_m), half]


def figure_eight(radius_m: float) -> list[Leg]:
    """A full circle to the left, then one to the right; they touch at the origin."""
    return [arc(2 * math.pi, radius_m), arc(-2 * math.pi, radius_m)]


def lawnmower(length_m: float, radius_m: float, rows: int) -> list[Leg]:
    """``rows`` (even) parallel lanes ``2 radius_m`` apart, then back along the side to the start."""
    legs: list[Leg] = []
    for row in range(rows):
        legs.append(Leg(length_m))
        if row < rows - 1:
            legs.append(arc(math.pi if row % 2 == 0 else -math.pi, radius_m))
    quarter = arc(math.pi / 2, radius_m)
    side = 2 * radius_m * (rows - 2)
    return [*legs, quarter, *([Leg(side)] if side > 0 else []), quarter]


def wander(
    generator: np.random.Generator,
    steps: int,
    speed_m_s: float,
    turn_max_rad_s: float,
    half_size_m: float,
    time_step_s: float,
) -> FloatArray:
    """Controls (steps-1, 2) towards one random waypoint after another in a square about the origin.

    A waypoint counts as reached within the turning circle's diameter, which no course can orbit for ever.

    Raises:
        UsageError: from the middle of the square hardly a waypoint, or none, is farther than that.
    """
    reached = max(2 * speed_m_s / turn_max_rad_s, speed_m_s * time_step_s)
    if reached > FARTHEST * half_size_m:
        raise UsageError(
            f"half_size_m is {half_size_m:g}: too small for a walk whose waypoints count as reached within "
            f"{reached:.3g} m (the turning circle's diameter, at least one step); "
            f"{reached / FARTHEST:.3g} or more is needed, or a higher turn rate, or a lower speed"
        )
    model, T = Unicycle(), np.eye(3)
    controls = np.empty((steps - 1, 2))
    goal = generator.uniform(-half_size_m, half_size_m, 2)
    for k in range(steps - 1):
        while np.hypot(*(goal - T[:2, 2])) <= reached:
            goal = generator.uniform(-half_size_m, half_size_m, 2)
        towards = goal - T[:2, 2]
        error = float(wrap(math.atan2(towards[1], towards[0]) - math.atan2(T[1, 0], T[0, 0])))
        rate = float(np.clip(error / time_step_s, -turn_max_rad_s, turn_max_rad_s))
        controls[k] = speed_m_s, rate
        T = T @ model.increment(controls[k], time_step_s)
    return controls
