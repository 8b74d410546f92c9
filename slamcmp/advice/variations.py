"""The same problem a little otherwise: what would change the advice?

Only seeded sources can be varied, and by parameters they have; what a recording was, it stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from slamcmp.experiment.config.experiment import Experiment

ODOMETRY = (
    "speed_sigma_m_s",
    "turn_sigma_deg_s",
    "lateral_sigma_m",
    "steering_sigma_deg",
    "wheel_sigma_m",
    "odometry_share",
    "translation_sigma_m",
    "translation_sigma_per_m",
    "rotation_sigma_deg",
    "heading_sigma_rad",
)
"""Sigmas of the odometry, in the sources that come with the package."""
SENSOR = (
    "range_sigma_m",
    "bearing_sigma_deg",
    "position_sigma_m",
    "observation_share",
    "sigma_px",
    "noise_sigma",
)
"""Sigmas of the sensor."""


@dataclass(frozen=True)
class Variation:
    """One change of the source."""

    name: str
    """As a sentence says it: ``twice the odometry noise``."""
    slug: str
    """Of its results folder."""
    parameters: Mapping[str, Any]
    """New values by name."""

    def of(self, problem: Experiment) -> Experiment:
        """The problem with the change made."""
        source = problem.source
        for name, value in self.parameters.items():
            source = source.with_parameter(name, value)
        return replace(problem, source=source)


def variations(problem: Experiment) -> list[Variation]:
    """What can be varied, the most telling first; nothing of a recording."""
    if problem.recordings or problem.seeds == (None,):
        return []
    now = dict(problem.source.parameters)
    found = []
    if "odometry_scale" in now:
        found.append(_scaled("twice the odometry noise", "odometry", now, ("odometry_scale",), 2.0))
    else:
        found.append(_scaled("twice the odometry noise", "odometry", now, ODOMETRY, 2.0))
    found += [
        _longer_laps(problem.source.name, now),
        _fewer_landmarks(now),
        _scaled("twice the sensor noise", "sensor", now, SENSOR, 2.0),
    ]
    return [each for each in found if each.parameters]


def _scaled(name: str, slug: str, now: Mapping[str, Any], known: tuple[str, ...], factor: float) -> Variation:
    changed = {
        each: now[each] * factor
        for each in known
        if isinstance(now.get(each), int | float) and not isinstance(now[each], bool) and now[each] > 0
    }
    return Variation(name, slug, changed)


def _fewer_landmarks(now: Mapping[str, Any]) -> Variation:
    name = "half the landmarks"
    if isinstance(now.get("in_view"), int | float):
        return Variation(name, "landmarks", {"in_view": now["in_view"] / 2})
    count = now.get("landmarks")
    enough = isinstance(count, int) and not isinstance(count, bool) and count >= 4
    return Variation(
        name, "landmarks", {"landmarks": count // 2} if isinstance(count, int) and enough else {}
    )


def _longer_laps(source: str, now: Mapping[str, Any]) -> Variation:
    """Laps of twice the length with as many landmarks in sight."""
    name = "half the loop closures"
    if source == "stereo_loop" and isinstance(now.get("lap_steps"), int):
        return Variation(name, "loops", {"lap_steps": 2 * now["lap_steps"]})
    if source == "circle":
        more = {} if now.get("in_view") is not None else {"landmarks": 2 * now["landmarks"]}
        return Variation(name, "loops", {"turn_deg_s": now["turn_deg_s"] / 2, **more})
    return Variation(name, "loops", {})
