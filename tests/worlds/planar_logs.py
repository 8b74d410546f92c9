"""Planar worlds under test, and their logs as streams."""

from __future__ import annotations

from slamcmp.registry import sources
from slamcmp.types import Frame, Log, MeasurementStream

WORLDS = ["circle", "corridor", "figure_eight", "lawnmower", "random"]
ODOMETRY = ["unicycle", "straight_then_turn", "bicycle", "encoders"]


def make(name: str, seed: int = 1, **parameters) -> Log:
    return sources.get(name).target(seed, **parameters)


def as_stream(log: Log) -> MeasurementStream:
    return MeasurementStream(
        log.problem,
        tuple(
            Frame(k, float(log.t[k]), log.T_prev_body[k], log.Q[k], seen.ids, seen.z, seen.R)
            for k, seen in enumerate(log.detections)
        ),
    )
