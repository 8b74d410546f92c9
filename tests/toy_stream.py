"""A small planar stream, built without any source or front end, for tests of the back ends."""

from __future__ import annotations

import numpy as np

from slamcmp import geometry
from slamcmp.models.sensors import make_sensor
from slamcmp.types import Frame, MeasurementStream, Problem


def toy_stream(
    *,
    frames: int = 60,
    landmarks: int = 12,
    sensor_name: str = "range_bearing",
    seed: int = 0,
    noise: float = 1.0,
    heading_sigma: float = 0.01,
    prior_sigma: float = 0.01,
    seen_at_once: int = 5,
) -> tuple[MeasurementStream, np.ndarray, np.ndarray]:
    """The stream, the true poses (K, 3, 3) and the true landmarks (L, 2).

    The robot drives circles of radius 6 m among landmarks within 12 m, and sees ``seen_at_once`` of them.
    """
    rng = np.random.default_rng(seed)
    sensor = make_sensor(sensor_name, {})
    world = rng.uniform(-12, 12, size=(landmarks, 2))
    increment = geometry.se2(0.6, 0.0, 0.1)
    Q = noise**2 * np.diag([0.05, 0.03, heading_sigma]) ** 2
    R_one = noise**2 * np.diag([0.1, 0.02 if sensor_name == "range_bearing" else 0.1]) ** 2
    P = prior_sigma**2 * noise**2 * np.diag([1.0, 1.0, (heading_sigma / 0.01) ** 2])
    T = geometry.retract(np.eye(3), rng.normal(size=3) * np.sqrt(np.diag(P)))
    made, truth = [], []
    for k in range(frames):
        if k:
            T = T @ geometry.retract(increment, rng.normal(size=3) * np.sqrt(np.diag(Q)))
        ids = rng.permutation(landmarks)[:seen_at_once]
        z = sensor.predict(T, world[ids]) + rng.normal(size=(ids.size, 2)) * np.sqrt(np.diag(R_one))
        made.append(
            Frame(
                k,
                0.1 * k,
                increment if k else np.eye(3),
                Q if k else np.zeros((3, 3)),
                ids,
                z,
                np.broadcast_to(R_one, (ids.size, 2, 2)),
            )
        )
        truth.append(T)
    return MeasurementStream(Problem(np.eye(3), P, sensor), tuple(made)), np.stack(truth), world
