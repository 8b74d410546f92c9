"""Streams and filters that the oracle tests share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from slamcmp import geometry
from slamcmp.backends.filters.error_state.charts import Chart
from slamcmp.backends.filters.error_state.linearisation import LatestEstimate
from slamcmp.backends.filters.error_state_ekf import ErrorStateEkf
from slamcmp.backends.filters.variants import (
    FirstEstimatesEkf,
    IdealEkf,
    ObservabilityConstrainedEkf,
    RightInvariantEkf,
    WorldEkf,
)
from slamcmp.models.sensors import RelativePosition
from slamcmp.types import Frame, GroundTruth, MeasurementStream, Problem
from tests.toy_stream import toy_stream

Make = Callable[[Problem, GroundTruth], ErrorStateEkf]


class BodyEkf(ErrorStateEkf):
    """The engine in the body tangent, which is ``ekf_slam`` with the error state "body"."""

    def __init__(self, problem: Problem, *, new_landmarks: Any = "join_first", smooth: bool = False) -> None:
        chart = Chart(problem.sensor.space_dim)
        super().__init__(problem, chart, LatestEstimate(), new_landmarks=new_landmarks, smooth=smooth)


def maker(filter_class: Any, **parameters: Any) -> Make:
    if filter_class is IdealEkf:
        return lambda problem, truth: filter_class(problem, truth, **parameters)
    return lambda problem, truth: filter_class(problem, **parameters)


CONSISTENT = (IdealEkf, FirstEstimatesEkf, ObservabilityConstrainedEkf, RightInvariantEkf)
"""Filters that leave the unobservable directions alone."""
PUBLISHED = (*CONSISTENT, WorldEkf)


def run(filter_: Any, stream: MeasurementStream) -> Any:
    for frame in stream.frames:
        filter_.update(frame)
    return filter_


def planar(**settings: Any) -> tuple[MeasurementStream, GroundTruth]:
    stream, poses, world = toy_stream(**settings)
    t = np.array([frame.t for frame in stream.frames])
    return stream, GroundTruth(t, poses, np.arange(len(world)), world)


def spatial(
    *, frames: int = 40, landmarks: int = 10, seed: int = 0, noise: float = 1.0, prior_sigma: float = 0.01
) -> tuple[MeasurementStream, GroundTruth]:
    """A climbing circle in space, five relative positions a frame."""
    rng = np.random.default_rng(seed)
    world = rng.uniform(-8, 8, size=(landmarks, 3))
    increment = geometry.exp(np.array([0.02, -0.03, 0.12, 0.6, 0.0, 0.05]))
    sigmas = noise * np.array([0.01, 0.01, 0.015, 0.05, 0.03, 0.03])
    R = (0.1 * noise) ** 2 * np.eye(3)
    P = (prior_sigma * noise) ** 2 * np.eye(6)
    sensor = RelativePosition(space_dim=3)
    T = geometry.exp(prior_sigma * noise * rng.normal(size=6))
    made, poses = [], []
    for k in range(frames):
        if k:
            T = T @ geometry.retract(increment, sigmas * rng.normal(size=6))
        ids = rng.permutation(landmarks)[:5]
        z = sensor.predict(T, world[ids]) + 0.1 * noise * rng.normal(size=(5, 3))
        step, Q = (increment, np.diag(sigmas**2)) if k else (np.eye(4), np.zeros((6, 6)))
        made.append(Frame(k, 0.1 * k, step, Q, ids, z, np.broadcast_to(R, (5, 3, 3))))
        poses.append(T)
    truth = GroundTruth(0.1 * np.arange(frames), np.stack(poses), np.arange(landmarks), world)
    return MeasurementStream(Problem(np.eye(4), P, sensor), tuple(made)), truth


def world_of(space_dim: int, **settings: Any) -> tuple[MeasurementStream, GroundTruth]:
    return planar(**settings) if space_dim == 2 else spatial(**settings)
